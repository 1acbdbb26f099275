"""An HTTP server for UM-Bridge, based on that of the standard library.

`umbridge.serve_models` listens on every interface of the machine, takes requests of any size, answers malformed ones
and failing models with a page of text instead of the protocol's errors, and writes NaN as `nan`, which is not JSON.
"""

import contextlib
import json
import socket
import sys
from collections.abc import Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from strandline.errors import InvalidInput
from strandline.models.umbridge.answers import Answer, Refused, ServedModel, answer
from strandline.models.umbridge.connections import Connections
from strandline.models.umbridge.door import Door

__all__ = ["LARGEST_REQUEST", "MOST_CONNECTIONS", "UMBridgeServer"]

LARGEST_REQUEST = 10 * 1000**2
"""Bytes of a request's body."""
MOST_CONNECTIONS = 128
"""Connections open at the same time, with a thread each."""
PATIENCE_SECONDS = 30.0
"""How long a client may take to send a request, and how long a connection may be idle between two requests."""
DRAINED_BYTES = 65536
"""A refused request is read up to this size, so that the client can read the reason."""


class UMBridgeServer(ThreadingHTTPServer):
    """Answers requests for `models`, each in its own thread; runs from `serve_forever` until `shutdown`.

    Several threads call the models' functions at once, so these functions must be thread-safe.

    Args:
        models: The models, with different names.
        host: Address to listen on; the default can be reached only from this machine.
        port: Port to listen on; 0 takes any free one, which `url` then holds.
        door: Object that decides which requests are answered; by default, those to an address of the server itself.
        connections: Largest number of connections, and of threads.
        patience: Seconds within which a client must send a whole request.

    Raises:
        InvalidInput: the server cannot listen on the address.
    """

    daemon_threads = True
    request_queue_size = MOST_CONNECTIONS

    def __init__(
        self,
        models: Sequence[ServedModel],
        host: str = "127.0.0.1",
        port: int = 4242,
        *,
        door: Door | None = None,
        connections: int = MOST_CONNECTIONS,
        patience: float = PATIENCE_SECONDS,
    ) -> None:
        self.models = tuple(models)
        self.door = Door.of(host) if door is None else door
        self.patience = patience
        self.connections = Connections(connections, patience)
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as error:
            raise InvalidInput(
                "address to serve on",
                value=f"{host}, port {port}: {error}",
                expected="an address of this machine and a port that is free",
                remedy="Choose another --port (0 takes any free one), or end what uses it.",
            ) from None

    @property
    def url(self) -> str:
        """Address of the server."""
        host, port = str(self.server_address[0]), self.server_address[1]
        return f"http://{f'[{host}]' if ':' in host else host}:{port}"

    def server_bind(self) -> None:
        """Bind without the base class's look-up of the machine's name, which can take seconds."""
        super(ThreadingHTTPServer, self).server_bind()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread, or turn the client away if all places are taken."""
        if not self.connections.admit(request):
            self._turn_away(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:
            self.connections.leave(request)
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer the requests of one connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.connections.leave(request)

    def service_actions(self) -> None:
        """End connections that have been silent for too long; called twice a second."""
        self.connections.end_overdue()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that go away; print one line about any other error."""
        error = sys.exception()
        if not isinstance(error, OSError):
            print(f"a request could not be answered: {type(error).__name__}: {str(error)[:200]!r}", file=sys.stderr)

    def _turn_away(self, request: Any) -> None:
        content = json.dumps(Refused("Busy", "too many connections; try again later", 503).answer.content).encode()
        head = f"HTTP/1.1 503 Service Unavailable\r\nContent-Length: {len(content)}\r\nConnection: close\r\n\r\n"
        with contextlib.suppress(OSError):
            request.settimeout(0.0)
            request.send(head.encode() + content)
        self.shutdown_request(request)


class _Handler(BaseHTTPRequestHandler):
    """Reads a request within its limits and writes the answer."""

    server: UMBridgeServer
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    wbufsize = -1

    def setup(self) -> None:
        super().setup()
        self.connection.settimeout(self.server.patience)

    def handle_one_request(self) -> None:
        self.server.connections.waits(self.connection)
        super().handle_one_request()

    def do_GET(self) -> None:
        self._reply()

    def do_POST(self) -> None:
        self._reply()

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer malformed HTTP, or a method that UM-Bridge does not have."""
        self.close_connection = True
        self._send(Refused("InvalidInput", message or HTTPStatus(code).phrase, code).answer)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Log nothing."""

    def version_string(self) -> str:
        return "strandline"

    def _reply(self) -> None:
        try:
            body = self._body(self._length())
        except Refused as refused:
            self.close_connection = True
            self._send(refused.answer)
            return
        self.server.connections.works(self.connection)
        path = self.path.partition("?")[0].partition("#")[0].rstrip("/")
        self._send(answer(self.server.models, self.command, path, body))

    def _length(self) -> int:
        """Return the size of the request's body, bytes."""
        told = set(self.headers.get_all("Content-Length", ["0"]))
        length = told.pop().strip()
        if told or "Transfer-Encoding" in self.headers or not (length.isascii() and length.isdigit()):
            raise Refused("InvalidInput", "the request does not state its length; send Content-Length", 411)
        digits = length.lstrip("0")[: len(str(LARGEST_REQUEST)) + 1] or "0"
        if int(digits) > LARGEST_REQUEST:
            raise Refused("InvalidInput", f"a request of more than {LARGEST_REQUEST // 1000**2} MB", 413)
        return int(digits)

    def _body(self, length: int) -> bytes:
        """Return the body of a request that the door lets in; the body of a refused one is not kept."""
        try:
            if not self.path.startswith("/"):
                raise Refused("InvalidInput", f"the path: got {self.path[:80]!r}; expected one such as /Info")
            self.server.door.check(self.command, self.headers)
        except Refused:
            if length <= DRAINED_BYTES:
                self.rfile.read(length)
            raise
        body = self.rfile.read(length)
        if len(body) < length:
            raise Refused("InvalidInput", f"{len(body)} of {length} bytes of the request arrived")
        return body

    def _send(self, given: Answer) -> None:
        content = json.dumps(given.content, allow_nan=False).encode()
        self.send_response(given.status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(content)))
        if given.status == HTTPStatus.UNAUTHORIZED:
            self.send_header("WWW-Authenticate", "Bearer")
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)
