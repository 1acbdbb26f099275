"""Who may see the page."""

from strandline.view.door import Door

DOOR = Door("secret-of-sixteen-letters")
RIGHT = DOOR.token


def test_this_machine_may() -> None:
    for host in ("127.0.0.1:80", "localhost:8123", "LOCALHOST", "[::1]:90", "127.1.2.3"):
        assert DOOR.refusal(host, None, RIGHT) == ""
        assert DOOR.refusal(host, f"http://{host}", RIGHT) == ""


def test_other_names_may_not() -> None:
    """A page whose domain points here calls it by that domain."""
    for host in ("example.org", "127.0.0.1.example.org", "192.168.0.3:80", "", "localhost.example.org"):
        assert "127.0.0.1 only" in DOOR.refusal(host, None, RIGHT)


def test_other_pages_may_not() -> None:
    for origin in ("http://example.org", "null", "http://localhost:81", "https://localhost:80.example.org"):
        assert "other web pages" in DOOR.refusal("localhost:80", origin, RIGHT)


def test_nobody_without_the_token() -> None:
    for given in ("", "secret", RIGHT + "x", RIGHT.upper()):
        assert "whole address" in DOOR.refusal("localhost:80", None, given)
    assert Door().token != Door().token
    assert len(Door().token) >= 24
