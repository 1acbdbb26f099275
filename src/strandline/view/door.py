"""Who may see the page: whoever has its address with the token, from this machine.

A server on the loopback address is within reach of every web page that the user opens, and of every user of the
machine. A page whose domain points to this address (DNS rebinding) is recognised by its `Host`; other users do not know
the token.
"""

import hmac
import ipaddress
import secrets
from dataclasses import dataclass, field

__all__ = ["HEADERS", "Door"]

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self' "
    "http://localhost:* http://127.0.0.1:*",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
"""Headers of every answer: nothing is loaded from elsewhere."""


@dataclass(frozen=True)
class Door:
    """Lets requests in, or refuses them.

    Args:
        token: Secret that each address must contain.
    """

    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))

    def refusal(self, host: str, origin: str | None, token: str) -> str:
        """Return why a request is refused; empty if it is let in.

        Args:
            host: Its header `Host`.
            origin: Its header `Origin`, if it has one.
            token: Token in its address; empty if there is none.
        """
        if not _is_loopback(_name(host)):
            return "this page is called by localhost or 127.0.0.1 only"
        if origin is not None and origin.partition("//")[2] != host:
            return "other web pages may not ask"
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return "this page needs the whole address that strandline view printed"
        return ""


def _name(host: str) -> str:
    """Return the name in a header `Host`, without the port."""
    name = host.strip().lower()
    return name[1:].partition("]")[0] if name.startswith("[") else name.partition(":")[0]


def _is_loopback(name: str) -> bool:
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return name.rstrip(".") == "localhost"
