"""Who is let in by the server of UM-Bridge."""

import base64
import socket
from email.message import Message

import pytest

from strandline.errors import InvalidInput
from strandline.models.umbridge.answers import Refused
from strandline.models.umbridge.door import Door

TOKEN = "0123456789abcdef"
PAGE = "https://example.org"


def status(door: Door, **headers: str) -> int:
    """Return the HTTP status with which a request is refused, 200 if it is let in."""
    message = Message()
    for name, text in ({"Host": "localhost", "Content-Type": "application/json"} | headers).items():
        if text:
            message[name] = text
    told = ""
    try:
        door.check("POST", message)
    except Refused as refused:
        told, found = str(refused), refused.status
    assert TOKEN not in told
    return found if told else 200


def test_it_answers_to_its_own_addresses_alone() -> None:
    """A page whose domain points here sends another name."""
    door = Door.of("127.0.0.1")
    for host in ("localhost", "LOCALHOST:4242", "localhost.", "127.0.0.1:1", "127.1.2.3", "[::1]:80"):
        assert status(door, Host=host) == 200
    for host in ("attacker.example", "attacker.example:4242", "10.0.0.1", "[fe80::1]", "", "localhost@x"):
        assert status(door, Host=host) == 403
    network = Door.of("0.0.0.0")
    names = ("10.0.0.1:4242", socket.gethostname(), "attacker.example")
    assert [status(network, Host=host) for host in names] == [200, 200, 403]


def test_pages_and_forms_are_refused_unless_they_are_allowed() -> None:
    door = Door.of("127.0.0.1")
    for origin in (PAGE, "null", "http://localhost:4242"):
        assert status(door, Origin=origin) == 403
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x"):
        assert status(door, **{"Content-Type": kind}) == 415
    assert status(door, **{"Content-Type": "Application/JSON; charset=utf-8"}) == 200
    allowed = Door.of("127.0.0.1", names=["Cell.example"], origins=[PAGE])
    assert status(allowed, Host="cell.example:80", Origin=PAGE) == 200
    assert status(allowed, Host="other.example") == 403


def test_a_token_is_needed_as_bearer_or_as_the_password_of_the_address() -> None:
    door = Door.of("127.0.0.1", token=TOKEN)
    wrong = base64.b64encode(f"any:{TOKEN}x".encode()).decode()
    for sent in ("", f"Bearer {TOKEN}x", "Basic !", f"Basic {wrong}", f"Other {TOKEN}"):
        assert status(door, Authorization=sent) == 401
    right = base64.b64encode(f"any:{TOKEN}".encode()).decode()
    for sent in (f"Bearer {TOKEN}", f"Basic {right}"):
        assert status(door, Authorization=sent) == 200


def test_a_token_that_is_weak_or_cannot_be_sent_is_refused() -> None:
    for token in ("", "short", "0123456789 abcdef", "0123456789abcdéf", "0123456789abcde\n", TOKEN[:-1]):
        with pytest.raises(InvalidInput, match="at least 16 printable ASCII characters") as caught:
            Door.of("127.0.0.1", token=token)
        assert token == "" or token not in str(caught.value)
