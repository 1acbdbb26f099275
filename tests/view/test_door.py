"""Who may see the page."""

import pytest

from strandline.view.door import Door

DOOR = Door("secret-of-sixteen-letters")
RIGHT = DOOR.token


@pytest.mark.parametrize("host", ["127.0.0.1:80", "localhost:8123", "LOCALHOST", "[::1]:90", "127.1.2.3"])
def test_this_machine_may(host: str) -> None:
    assert DOOR.refusal(host, None, RIGHT) == ""
    assert DOOR.refusal(host, f"http://{host}", RIGHT) == ""


@pytest.mark.parametrize(
    "host", ["example.org", "127.0.0.1.example.org", "192.168.0.3:80", "", "localhost.example.org"]
)
def test_other_names_may_not(host: str) -> None:
    """A page whose domain points here calls it by that domain."""
    assert "127.0.0.1 only" in DOOR.refusal(host, None, RIGHT)


@pytest.mark.parametrize(
    "origin", ["http://example.org", "null", "http://localhost:81", "https://localhost:80.example.org"]
)
def test_other_pages_may_not(origin: str) -> None:
    assert "other web pages" in DOOR.refusal("localhost:80", origin, RIGHT)


@pytest.mark.parametrize("given", ["", "secret", RIGHT + "x", RIGHT.upper()])
def test_nobody_without_the_token(given: str) -> None:
    assert "whole address" in DOOR.refusal("localhost:80", None, given)


def test_tokens_differ() -> None:
    assert Door().token != Door().token
    assert len(Door().token) >= 24
