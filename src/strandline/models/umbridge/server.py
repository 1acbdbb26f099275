"""An HTTP server for UM-Bridge, on the standard library's.

`umbridge.serve_models` listens on every interface of the machine, takes requests of any size, answers malformed ones
and failing models with a page of text instead of the protocol's errors, and writes NaN as `nan`, which is no JSON.
"""

import json
import socket
import sys
from collections.abc import Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from strandline.errors import InvalidInput
from strandline.models.umbridge.answers import Answer, Refused, ServedModel, answer

__all__ = ["LARGEST_REQUEST", "UMBridgeServer"]

LARGEST_REQUEST = 10 * 1000**2
"""Bytes of a request's body."""
PATIENCE_SECONDS = 30
"""How long a client may be silent within a request, or between two."""


class UMBridgeServer(ThreadingHTTPServer):
    """Answers for `models`, each request in a thread of its own; `serve_forever` until `shutdown`.

    The models' functions are called by several threads at once and see to themselves that this does no harm.

    Args:
        models: the models, with different names.
        host: the address to listen on; the default is reached from this machine alone.
        port: 0 for any free one; `url` tells which.

    Raises:
        InvalidInput: the address cannot be listened on.
    """

    daemon_threads = True

    def __init__(self, models: Sequence[ServedModel], host: str = "127.0.0.1", port: int = 4242) -> None:
        self.models = tuple(models)
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
        """Where it is found."""
        host, port = str(self.server_address[0]), self.server_address[1]
        return f"http://{f'[{host}]' if ':' in host else host}:{port}"

    def server_bind(self) -> None:
        """Bind, without the look-up of the machine's name that the base class makes and that can take seconds."""
        super(ThreadingHTTPServer, self).server_bind()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of clients that go away."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """Reads a request within its limits and writes the answer."""

    server: UMBridgeServer
    protocol_version = "HTTP/1.1"
    timeout = PATIENCE_SECONDS
    disable_nagle_algorithm = True
    wbufsize = -1

    def do_GET(self) -> None:
        self._reply()

    def do_POST(self) -> None:
        self._reply()

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer what is no proper HTTP, or a method that UM-Bridge does not have."""
        self.close_connection = True
        self._send(Refused("InvalidInput", message or HTTPStatus(code).phrase, code).answer)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Say nothing of requests."""

    def version_string(self) -> str:
        return "strandline"

    def _reply(self) -> None:
        try:
            body = self._body()
        except Refused as refused:
            self.close_connection = True
            self._send(refused.answer)
            return
        self._send(answer(self.server.models, self.command, urlsplit(self.path).path.rstrip("/"), body))

    def _body(self) -> bytes:
        """Return the body of the request; one whose length is not told or too large is not read."""
        length = self.headers.get("Content-Length", "0")
        if "Transfer-Encoding" in self.headers or not (length.isascii() and length.isdigit()):
            raise Refused("InvalidInput", "the request does not tell its length; send Content-Length", 411)
        if int(length[:20]) > LARGEST_REQUEST:
            raise Refused("InvalidInput", f"a request of more than {LARGEST_REQUEST // 1000**2} MB", 413)
        body = self.rfile.read(int(length))
        if len(body) < int(length):
            raise Refused("InvalidInput", f"{len(body)} of {length} bytes of the request came")
        return body

    def _send(self, given: Answer) -> None:
        content = json.dumps(given.content, allow_nan=False).encode()
        self.send_response(given.status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(content)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)
