"""The server of UM-Bridge over HTTP: the suite that the reference implementation judges, its client, connections."""

import contextlib
import json
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest
import umbridge
from tests.doors.models.waiting import until
from tests.unit.models.umbridge.served import AT, BARE, TOKEN, WHOLE, served

from strandline.foundations import ForwardModelError, InvalidInput
from strandline.models.umbridge.answers import ServedModel
from strandline.models.umbridge.client import TOKEN_VARIABLE, Client
from strandline.models.umbridge.server import Access, UMBridgeServer
from strandline.testing.umbridge import CHECKS, STRICT_CHECKS, ModelUnderTest

POST = b"POST /Evaluate HTTP/1.1\r\nHost: localhost\r\n"
NO_REQUESTS = [
    b"nonsense\r\n\r\n",
    b"GET http://[::1 HTTP/1.1\r\nHost: localhost\r\n\r\n",
    b"GET /Info HTTP/1.0\r\n\r\n",
    POST + b"Content-Length: -1\r\n\r\n",
    POST + b"Content-Length: " + b"0" * 20 + b"99999999999\r\n\r\n",
    POST + b"Content-Length: 2\r\nContent-Length: 3\r\n\r\n{}",
    POST + "Content-Length: ²\r\n\r\n".encode("latin-1"),
    POST + b"Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n",
    b"GET /" + b"a" * 70000 + b" HTTP/1.1\r\n\r\n",
    b"GET /Info HTTP/1.1\r\n" + b"a: b\r\n" * 200 + b"\r\n",
]


def connected(url):
    address = httpx.URL(url)
    return socket.create_connection((address.host, address.port), timeout=10)


@pytest.fixture(scope="module")
def ours():
    with served(WHOLE, BARE) as url:
        yield url


@pytest.mark.smoke
def test_it_passes_its_own_suite_over_http(ours):
    for check in {**CHECKS, **STRICT_CHECKS}.values():
        for name in ("whole", "bare"):
            check(ModelUnderTest(ours, name, AT))


def test_so_does_the_reference_in_a_process_of_its_own():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    peer, url = Path(__file__).with_name("umbridge_peer.py"), f"http://127.0.0.1:{port}"

    def answers():
        with contextlib.suppress(httpx.TransportError):
            return bool(httpx.get(f"{url}/Info", trust_env=False, verify=False))

    with subprocess.Popen([sys.executable, str(peer), str(port)], stdout=subprocess.DEVNULL) as process:
        try:
            until(answers)
            for check in CHECKS.values():
                for name in ("whole", "bare"):
                    check(ModelUnderTest(url, name, AT))
        finally:
            process.kill()


@pytest.mark.smoke
def test_the_reference_client_gets_the_same_numbers(ours):
    model = umbridge.HTTPModel(ours, "whole")
    x, y = AT[0]
    assert umbridge.supported_models(ours) == ["whole", "bare"]
    assert (model.get_input_sizes(), model.get_output_sizes()) == ([2], [3])
    assert model(AT) == [[x * x, x * y, y]]
    assert model.gradient(0, 0, AT, [1.0, 10.0, 100.0]) == [2 * x + 10 * y, 10 * x + 100]
    assert model.apply_jacobian(0, 0, AT, [3.0, 4.0]) == [6 * x, 3 * y + 4 * x, 4.0]
    with pytest.raises(Exception, match="ModelError: singular: the matrix is singular"):
        model([[2.0, 0.0]])


@pytest.mark.smoke
def test_what_is_no_proper_request_gets_an_error_and_the_next_one_an_answer(ours, capfd):
    for sent in NO_REQUESTS:
        with connected(ours) as connection:
            connection.sendall(sent)
            connection.shutdown(socket.SHUT_WR)
            reply = b"".join(iter(lambda connection=connection: connection.recv(65536), b""))
        assert set(json.loads(reply.rpartition(b"\r\n")[2])["error"]) == {"type", "message"}, sent
        assert b" 4" in reply.partition(b"\r\n")[0] or reply.startswith((b"{", b"HTTP/1.1 5"))
        assert ModelUnderTest(ours, "whole", AT).ask("Evaluate", input=AT)
    assert capfd.readouterr().err == ""


def test_it_listens_on_this_machine_alone_unless_told_otherwise():
    with UMBridgeServer([BARE], port=0) as server:
        assert server.server_address[0] == "127.0.0.1"
        with pytest.raises(InvalidInput, match="port"):
            UMBridgeServer([BARE], port=server.server_address[1])


def test_a_token_is_sent_by_our_client_and_by_the_reference(monkeypatch):
    with served(WHOLE, door=Access.of("127.0.0.1", token=TOKEN)) as url:
        x, y = AT[0]
        assert umbridge.HTTPModel(url.replace("//", f"//any:{TOKEN}@"), "whole")(AT) == [[x * x, x * y, y]]
        client = Client(url, "whole")
        monkeypatch.delenv(TOKEN_VARIABLE, raising=False)
        with pytest.raises(ForwardModelError, match="needs its token"):
            client.describe()
        monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
        assert client.evaluate(AT, [3])[0].tolist() == [x * x, x * y, y]


def test_silent_and_dripping_connections_are_ended_in_time():
    sent = 0
    with served(BARE, patience=0.2) as url, connected(url) as quiet, connected(url) as dripping:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            while sent < 200:
                dripping.sendall(b"G")
                sent += 1
                time.sleep(0.05)
        assert sent < 200
        assert quiet.recv(1) == b""


def test_a_connection_at_work_is_not_ended():
    begun, going = threading.Event(), threading.Event()

    def slow(blocks):
        begun.set()
        going.wait(10)
        return blocks

    model = ServedModel("slow", (2,), (2,), slow)
    with served(model, connections=1, patience=0.1) as url, ThreadPoolExecutor(1) as pool:
        answer = pool.submit(ModelUnderTest(url, "slow", AT).ask, "Evaluate", input=AT)
        assert begun.wait(10)
        turned_away = httpx.get(f"{url}/Info", trust_env=False, verify=False)
        going.set()
        assert answer.result() == {"output": AT}
    assert (turned_away.status_code, turned_away.json()["error"]["type"]) == (503, "Busy")
