"""Who is let in by the server of UM-Bridge, and how many at the same time."""

import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
import umbridge

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.umbridge.answers import ServedModel
from strandline.models.umbridge.client import TOKEN_VARIABLE, Client
from strandline.models.umbridge.door import Door
from strandline.models.umbridge.server import UMBridgeServer

TOKEN = "0123456789abcdef"
PAGE = "https://example.org"
DOUBLE = ServedModel("double", (1,), (1,), lambda blocks: [[2 * blocks[0][0]]])


@contextlib.contextmanager
def served(model: ServedModel = DOUBLE, **options: Any) -> Iterator[str]:
    server = UMBridgeServer([model], port=0, **options)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield server.url
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def post(url: str, **headers: str) -> httpx.Response:
    """Return the answer to an evaluation, sent with other headers."""
    given = {"Content-Type": "application/json"} | {name.replace("_", "-"): text for name, text in headers.items()}
    body = b'{"name": "double", "input": [[2.0]]}'
    return httpx.post(f"{url}/Evaluate", content=body, headers=given, trust_env=False, verify=False)


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with served() as address:
        yield address


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:4242", "localhost.", "127.0.0.1:1", "127.1.2.3", "[::1]:80"])
def test_it_answers_to_its_own_addresses(url: str, host: str) -> None:
    assert post(url, Host=host).json() == {"output": [[4.0]]}


@pytest.mark.parametrize(
    "host", ["attacker.example", "attacker.example:4242", "10.0.0.1", "[fe80::1]", "", "localhost@x"]
)
def test_a_page_whose_domain_points_here_is_refused(url: str, host: str) -> None:
    answer = post(url, Host=host)
    assert (answer.status_code, answer.json()["error"]["type"]) == (403, "Forbidden")
    assert "expected localhost or 127.0.0.1" in answer.json()["error"]["message"]


def test_a_request_without_a_host_is_refused(url: str) -> None:
    address = httpx.URL(url)
    with socket.create_connection((address.host, address.port or 0), timeout=10) as connection:
        connection.sendall(b"GET /Info HTTP/1.0\r\n\r\n")
        assert b" 403 " in connection.recv(65536)


@pytest.mark.parametrize("origin", [PAGE, "null", "http://localhost:4242"])
def test_a_page_that_tells_its_origin_is_refused(url: str, origin: str) -> None:
    answer = post(url, Origin=origin)
    assert (answer.status_code, answer.json()["error"]["type"]) == (403, "Forbidden")


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x"])
def test_what_a_form_can_send_is_refused(url: str, kind: str) -> None:
    assert post(url, Content_Type=kind).status_code == 415
    assert post(url, Content_Type="Application/JSON; charset=utf-8").status_code == 200


def test_names_and_pages_can_be_allowed() -> None:
    door = Door.of("127.0.0.1", names=["Cell.example"], origins=[PAGE])
    with served(door=door) as url:
        assert post(url, Host="cell.example:80", Origin=PAGE).status_code == 200
        assert post(url, Host="other.example").status_code == 403


def test_a_server_for_the_network_answers_to_any_address_and_to_no_strange_name() -> None:
    with served(door=Door.of("0.0.0.0")) as url:
        codes = [
            post(url, Host=host).status_code for host in ("10.0.0.1:4242", socket.gethostname(), "attacker.example")
        ]
    assert codes == [200, 200, 403]


@pytest.fixture(scope="module")
def guarded() -> Iterator[str]:
    with served(door=Door.of("127.0.0.1", token=TOKEN)) as address:
        yield address


class TestToken:
    @pytest.mark.parametrize("sent", [{}, {"Authorization": f"Bearer {TOKEN}x"}, {"Authorization": "Basic !"}])
    def test_without_it_nothing_is_answered(self, guarded: str, sent: dict[str, str]) -> None:
        answer = post(guarded, **sent)
        assert (answer.status_code, answer.json()["error"]["type"]) == (401, "Unauthorized")
        assert TOKEN not in answer.text

    def test_it_is_sent_as_bearer(self, guarded: str) -> None:
        assert post(guarded, Authorization=f"Bearer {TOKEN}").json() == {"output": [[4.0]]}

    def test_the_reference_client_sends_it_as_the_password_of_the_address(self, guarded: str) -> None:
        model = umbridge.HTTPModel(guarded.replace("//", f"//any:{TOKEN}@"), "double")
        assert model([[3.0]]) == [[6.0]]

    def test_our_client_takes_it_from_the_environment(self, guarded: str, monkeypatch: pytest.MonkeyPatch) -> None:
        client = Client(guarded, "double")
        monkeypatch.delenv(TOKEN_VARIABLE, raising=False)
        with pytest.raises(ForwardModelError, match="needs its token") as caught:
            client.describe()
        assert caught.value.kind == "protocol"
        monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
        assert client.describe().input_sizes == (1,)
        assert client.evaluate([[3.0]], [1])[0].tolist() == [6.0]

    @pytest.mark.parametrize("token", ["", "short", "0123456789 abcdef", "0123456789abcdéf", "0123456789abcde\n"])
    def test_one_that_is_weak_or_cannot_be_sent_is_refused(self, token: str) -> None:
        with pytest.raises(InvalidInput, match="at least 16 printable ASCII characters") as caught:
            Door.of("127.0.0.1", token=token)
        assert token == "" or token not in str(caught.value)


class TestManyConnections:
    @contextlib.contextmanager
    def silent(self, url: str, number: int) -> Iterator[list[socket.socket]]:
        address = httpx.URL(url)
        opened = [socket.create_connection((address.host, address.port or 0), timeout=10) for _ in range(number)]
        try:
            yield opened
        finally:
            for connection in opened:
                connection.close()

    def test_silent_ones_take_no_more_threads_than_there_are_places_and_make_way(self) -> None:
        before = threading.active_count()
        with served(connections=4) as url, self.silent(url, 9):
            assert post(url).json() == {"output": [[4.0]]}
            assert threading.active_count() <= before + 1 + 4

    def test_silent_ones_are_ended_in_time(self) -> None:
        before = threading.active_count()
        with served(connections=30, patience=0.2) as url, self.silent(url, 20) as opened:
            for connection in opened:
                assert connection.recv(1) == b""
            self.wait_for_threads(before + 1)

    def test_one_that_drips_is_ended_too(self) -> None:
        with served(patience=0.3) as url, self.silent(url, 1) as (connection,):
            sent = 0
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                while sent < 200:
                    connection.sendall(b"G")
                    sent += 1
                    time.sleep(0.05)
            assert sent < 200

    def test_a_connection_at_work_is_not_ended(self) -> None:
        going = threading.Event()

        def slow(blocks: list[list[float]]) -> list[list[float]]:
            going.wait(10)
            return blocks

        model = ServedModel("double", (1,), (1,), slow)
        answers: list[httpx.Response] = []
        with served(model, connections=1, patience=0.1) as url:
            asking = threading.Thread(target=lambda: answers.append(post(url)))
            asking.start()
            time.sleep(0.4)
            turned_away = httpx.get(f"{url}/Info", trust_env=False, verify=False)
            going.set()
            asking.join()
        assert (turned_away.status_code, turned_away.json()["error"]["type"]) == (503, "Busy")
        assert answers[0].json() == {"output": [[2.0]]}

    def wait_for_threads(self, number: int) -> None:
        deadline = time.monotonic() + 10
        while threading.active_count() > number:
            assert time.monotonic() < deadline
            time.sleep(0.02)
