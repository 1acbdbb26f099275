"""Who may send requests to a server: checks of the headers, made before anything is computed.

A server on the loopback address is within reach of every web page that the user opens, and of every user of the
machine. A page is recognised by its `Origin`, or, if its domain points to this address (DNS rebinding), by its `Host`;
a form cannot send JSON. Against other users only a token helps.
"""

import base64
import binascii
import hmac
import ipaddress
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from email.message import Message

from strandline.errors import InvalidInput
from strandline.models.umbridge.answers import Refused

__all__ = ["SHORTEST_TOKEN", "Door", "is_loopback"]

SHORTEST_TOKEN = 16
"""Fewest characters of a token."""
SHOWN_CHARACTERS = 80


@dataclass(frozen=True)
class Door:
    """Lets requests in, or refuses them.

    Args:
        names: Names under which the server may be called (`Host`), in lower case.
        any_address: Whether it may be called by any numeric address; if not, by loopback addresses only.
        origins: Web pages that may send requests (`Origin`), e.g. ``https://example.org``.
        token: Secret that each request must carry; None for none.

    Raises:
        InvalidInput: a token that is too short, or that no header can carry.
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
            raise InvalidInput(
                "token",
                value=f"{len(token)} characters",
                expected=f"at least {SHORTEST_TOKEN} printable ASCII characters without blanks",
                remedy="Make one: python -c 'import secrets; print(secrets.token_urlsafe())'",
            )

    @classmethod
    def of(
        cls, host: str, *, names: Iterable[str] = (), origins: Iterable[str] = (), token: str | None = None
    ) -> "Door":
        """Return the door of a server that listens on `host`; `names` are further names of the server."""
        known = {"localhost", *(name.lower().rstrip(".") for name in names)}
        local = is_loopback(host)
        if not local:
            machine = socket.gethostname().lower()
            known |= {host.lower(), machine, machine.partition(".")[0]}
        return cls(frozenset(known), not local, frozenset(origins), token)

    def check(self, method: str, headers: Message) -> None:
        """Refuse a request that may come from a web page, or that lacks the token.

        Raises:
            Refused: The request is refused with HTTP 401, 403 or 415.
        """
        hosts, origin = headers.get_all("Host", []), headers.get("Origin")
        if len(hosts) != 1 or not self._is_called(hosts[0]):
            found = ", ".join(hosts) or "none"
            expected = "this machine's numeric address or name" if self.any_address else "localhost or 127.0.0.1"
            told = f"Host: got {_shown(found)}; expected {expected}. Allow a further name by `serve --allow-host NAME`."
            raise Refused("Forbidden", told, 403)
        if origin is not None and origin not in self.origins:
            told = f"Origin: got {_shown(origin)}; web pages may not send requests. See `serve --allow-origin`."
            raise Refused("Forbidden", told, 403)
        kind = headers.get("Content-Type")
        if method == "POST" and kind is not None and kind.partition(";")[0].strip().lower() != "application/json":
            raise Refused("InvalidInput", f"Content-Type: got {_shown(kind)}; expected application/json", 415)
        if self.token is not None and not _carries(headers.get("Authorization", ""), self.token):
            raise Refused("Unauthorized", "this server needs its token: send `Authorization: Bearer TOKEN`", 401)

    def _is_called(self, host: str) -> bool:
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


def _shown(text: str) -> str:
    shown = repr(text)
    return shown if len(shown) <= SHOWN_CHARACTERS else f"{shown[:SHOWN_CHARACTERS]}…"
