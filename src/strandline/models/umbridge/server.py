"""An HTTP server for UM-Bridge, based on that of the standard library, and who may send it requests.

`umbridge.serve_models` listens on every interface of the machine, takes requests of any size, answers malformed ones
and failing models with a page of text instead of the protocol's errors, and writes NaN as `nan`, which is not JSON.

A server on the loopback address is within reach of every web page that the user opens, and of every user of the
machine. A page is recognised by its `Origin`, or, if its domain points to this address (DNS rebinding), by its `Host`;
a form cannot send JSON. Against other users only a token helps.
"""

import base64
import binascii
import contextlib
import hmac
import ipaddress
import json
import socket
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from email.message import Message
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from strandline.foundations import unfit
from strandline.models.umbridge.answers import Rejected, Reply, ServedModel, answer
from strandline.models.umbridge.client import shortened

SHORTEST_TOKEN = 16
"""Fewest characters of a token."""
LARGEST_REQUEST = 10 * 1000**2
"""Bytes of a request's body."""
MOST_CONNECTIONS = 128
"""Connections open at the same time, with a thread each."""
PATIENCE_SECONDS = 30.0
"""How long a client may take to send a request, and how long a connection may be idle between two requests."""
DRAINED_BYTES = 65536
"""A refused request is read up to this size, so that the client can read the reason."""


@dataclass(frozen=True)
class Access:
    """Lets requests in, or refuses them.

    The server may be called (`Host`) by `names` in lower case, and by loopback addresses or `any_address`. Web pages of
    the `origins`, e.g. ``https://example.org``, may send requests. Each must carry the `token`, if there is one.
    """

    names: frozenset[str] = frozenset({"localhost"})
    any_address: bool = False
    origins: frozenset[str] = frozenset()
    token: str | None = None

    def __post_init__(self) -> None:
        token = self.token
        if token is None:
            return
        if len(token) < SHORTEST_TOKEN or not (token.isascii() and token.isprintable()) or " " in token:
            expected = f"at least {SHORTEST_TOKEN} printable ASCII characters without blanks"
            remedy = "Make one: python -c 'import secrets; print(secrets.token_urlsafe())'"
            raise unfit("token", f"{len(token)} characters", expected, remedy)

    @classmethod
    def of(
        cls, host: str, *, names: Iterable[str] = (), origins: Iterable[str] = (), token: str | None = None
    ) -> "Access":
        """Return the door of a server that listens on `host`; `names` are further names of the server."""
        known = {"localhost", *(name.lower().rstrip(".") for name in names)}
        local = is_loopback(host)
        if not local:
            machine = socket.gethostname().lower()
            known |= {host.lower(), machine, machine.partition(".")[0]}
        return cls(frozenset(known), not local, frozenset(origins), token)

    def check(self, method: str, headers: Message) -> None:
        """Refuse (HTTP 401, 403 or 415) a request that may come from a web page, or that lacks the token."""
        hosts, origin = headers.get_all("Host", []), headers.get("Origin")
        if len(hosts) != 1 or not self.is_called(hosts[0]):
            found = ", ".join(hosts) or "none"
            expected = "this machine's numeric address or name" if self.any_address else "localhost or 127.0.0.1"
            told = f"Host: got {shortened(found)}; expected {expected}."
            raise Rejected("Forbidden", f"{told} Allow a further name by `serve --allow-host NAME`.", 403)
        if origin is not None and origin not in self.origins:
            told = f"Origin: got {shortened(origin)}; web pages may not send requests. See `serve --allow-origin`."
            raise Rejected("Forbidden", told, 403)
        kind = headers.get("Content-Type")
        if method == "POST" and kind is not None and kind.partition(";")[0].strip().lower() != "application/json":
            raise Rejected("InvalidInput", f"Content-Type: got {shortened(kind)}; expected application/json", 415)
        if self.token is not None and not _carries(headers.get("Authorization", ""), self.token):
            raise Rejected("Unauthorized", "this server needs its token: send `Authorization: Bearer TOKEN`", 401)

    def is_called(self, host: str) -> bool:
        """Return whether `host`, with or without a port, is a name or address of this server."""
        name = host.strip().lower()
        name = name[1:].partition("]")[0] if name.startswith("[") else name.partition(":")[0]
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return name.rstrip(".") in self.names
        return self.any_address or address.is_loopback


def is_loopback(host: str) -> bool:
    """Return whether an address to listen on can be reached only from this machine."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _carries(authorization: str, token: str) -> bool:
    """Return whether a header carries the token: as ``Bearer TOKEN``, or as the password of ``Basic``."""
    scheme, _, given = authorization.partition(" ")
    if scheme.lower() == "basic":
        try:
            given = base64.b64decode(given.strip(), validate=True).decode("utf-8", "replace").partition(":")[2]
        except (binascii.Error, ValueError):
            return False
    elif scheme.lower() != "bearer":
        return False
    return hmac.compare_digest(given.strip().encode(), token.encode())


class UMBridgeServer(ThreadingHTTPServer):
    """Answers requests for `models`, each in its own thread; runs from `serve_forever` until `shutdown`.

    Several threads call the models' functions at once, so these functions must be thread-safe. Port 0 takes any free
    one, which `url` then holds. The `door` decides which requests are answered; by default, those to an address of the
    server itself. There are so many `connections`, and threads, at most; a request must arrive within `patience`
    seconds.
    """

    daemon_threads = True
    request_queue_size = MOST_CONNECTIONS

    def __init__(
        self,
        models: Sequence[ServedModel],
        host: str = "127.0.0.1",
        port: int = 4242,
        *,
        door: Access | None = None,
        connections: int = MOST_CONNECTIONS,
        patience: float = PATIENCE_SECONDS,
    ) -> None:
        self.models = tuple(models)
        self.door = Access.of(host) if door is None else door
        self.patience = patience
        self._free, self._lock = threading.BoundedSemaphore(connections), threading.Lock()
        self._waiting: dict[socket.socket, float] = {}
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as error:
            expected = "an address of this machine and a port that is free"
            remedy = "Choose another --port (0 takes any free one), or end what uses it."
            raise unfit("address to serve on", f"{host}, port {port}: {error}", expected, remedy) from None

    @property
    def url(self) -> str:
        host, port = str(self.server_address[0]), self.server_address[1]
        return f"http://{f'[{host}]' if ':' in host else host}:{port}"

    def server_bind(self) -> None:
        """Bind without the base class's look-up of the machine's name, which can take seconds."""
        super(ThreadingHTTPServer, self).server_bind()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread, or turn the client away if all places are taken."""
        if not self._free.acquire(blocking=False):
            self._turn_away(request)
            return
        self.waits(request)
        try:
            super().process_request(request, client_address)
        except BaseException:
            self._leave(request)
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._leave(request)

    def service_actions(self) -> None:
        """End connections without a whole request in time, even if the client keeps sending; called twice a second."""
        limit = time.monotonic() - self.patience
        with self._lock:
            for connection in [one for one, since in self._waiting.items() if since <= limit]:
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def waits(self, connection: socket.socket) -> None:
        """Note that the connection waits for its client's next request, from now on."""
        with self._lock:
            self._waiting[connection] = time.monotonic()

    def works(self, connection: socket.socket) -> None:
        """Note that the client has sent its request; a connection at work is never ended."""
        with self._lock:
            self._waiting.pop(connection, None)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that go away; print one line about any other error."""
        error = sys.exception()
        if not isinstance(error, OSError):
            print(f"a request could not be answered: {type(error).__name__}: {str(error)[:200]!r}", file=sys.stderr)

    def _leave(self, connection: socket.socket) -> None:
        self.works(connection)
        self._free.release()

    def _turn_away(self, request: Any) -> None:
        content = json.dumps(Rejected("Busy", "too many connections; try again later", 503).answer.content).encode()
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
        self.server.waits(self.connection)
        super().handle_one_request()

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer malformed HTTP, or a method that UM-Bridge does not have."""
        self.close_connection = True
        self._send(Rejected("InvalidInput", message or HTTPStatus(code).phrase, code).answer)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Log nothing."""

    def version_string(self) -> str:
        return "strandline"

    def do_POST(self) -> None:
        """Answer a request; one that the door refuses also ends the connection."""
        try:
            body = self._body(self._length())
        except Rejected as refused:
            self.close_connection = True
            self._send(refused.answer)
            return
        self.server.works(self.connection)
        path = self.path.partition("?")[0].partition("#")[0].rstrip("/")
        self._send(answer(self.server.models, self.command, path, body))

    do_GET = do_POST

    def _length(self) -> int:
        """Return the size of the request's body, bytes."""
        told = set(self.headers.get_all("Content-Length", ["0"]))
        length = told.pop().strip()
        if told or "Transfer-Encoding" in self.headers or not (length.isascii() and length.isdigit()):
            raise Rejected("InvalidInput", "the request does not state its length; send Content-Length", 411)
        digits = length.lstrip("0")[: len(str(LARGEST_REQUEST)) + 1] or "0"
        if int(digits) > LARGEST_REQUEST:
            raise Rejected("InvalidInput", f"a request of more than {LARGEST_REQUEST // 1000**2} MB", 413)
        return int(digits)

    def _body(self, length: int) -> bytes:
        """Return the body of a request that the door lets in; the body of a refused one is not kept."""
        try:
            if not self.path.startswith("/"):
                raise Rejected("InvalidInput", f"the path: got {self.path[:80]!r}; expected one such as /Info")
            self.server.door.check(self.command, self.headers)
        except Rejected:
            if length <= DRAINED_BYTES:
                self.rfile.read(length)
            raise
        body = self.rfile.read(length)
        if len(body) < length:
            raise Rejected("InvalidInput", f"{len(body)} of {length} bytes of the request arrived")
        return body

    def _send(self, given: Reply) -> None:
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
