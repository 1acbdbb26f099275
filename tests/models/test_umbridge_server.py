"""The server of UM-Bridge against its own suite, which is judged by the reference implementation, and its client."""

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import umbridge

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.umbridge.answers import ServedModel
from strandline.models.umbridge.server import UMBridgeServer
from strandline.testing.umbridge import CHECKS, STRICT_CHECKS, ModelUnderTest

AT = [[0.5, -2.0]]
POST = b"POST /Evaluate HTTP/1.1\r\nHost: localhost\r\n"


def whole(blocks: list[list[float]]) -> list[list[float]]:
    x, y = blocks[0]
    if x > 1:
        raise ForwardModelError("singular", "the matrix is singular")
    if x < -1:
        raise InvalidInput("x", value=x, expected="at least -1", remedy="Choose another.")
    if x == 1:
        raise ZeroDivisionError("by nothing")
    return [[x * x, x * y, y]]


WHOLE = ServedModel(
    "whole",
    (2,),
    (3,),
    whole,
    gradient=lambda out, into, b, s: [2 * b[0][0] * s[0] + b[0][1] * s[1], b[0][0] * s[1] + s[2]],
    apply_jacobian=lambda out, into, b, v: [2 * b[0][0] * v[0], b[0][1] * v[0] + b[0][0] * v[1], v[1]],
)
BARE = ServedModel("bare", (2,), (3,), whole)


@pytest.fixture(scope="module")
def ours() -> Iterator[str]:
    with served(WHOLE, BARE) as url:
        yield url


class served:  # noqa: N801
    """Context of a server in a thread; yields its address."""

    def __init__(self, *models: ServedModel) -> None:
        self.server = UMBridgeServer(models, port=0)
        self.thread = threading.Thread(target=self.server.serve_forever, args=(0.05,))

    def __enter__(self) -> str:
        self.thread.start()
        return self.server.url

    def __exit__(self, *_: object) -> None:
        self.server.shutdown()
        self.thread.join()
        self.server.server_close()


@pytest.fixture(scope="module")
def reference() -> Iterator[str]:
    """A server of the reference implementation in a process of its own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    peer = Path(__file__).with_name("umbridge_peer.py")
    process = subprocess.Popen([sys.executable, str(peer), str(port)], stdout=subprocess.DEVNULL)
    url = f"http://127.0.0.1:{port}"
    try:
        deadline = time.monotonic() + 60
        while True:
            try:
                httpx.get(f"{url}/Info", trust_env=False, verify=False)
                break
            except httpx.TransportError:
                assert process.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.1)
        yield url
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize("name", ["whole", "bare"])
@pytest.mark.parametrize("check", CHECKS.values(), ids=CHECKS.keys())
class TestConformity:
    def test_ours(self, ours: str, check: Any, name: str) -> None:
        check(ModelUnderTest(ours, name, AT))

    def test_the_reference(self, reference: str, check: Any, name: str) -> None:
        check(ModelUnderTest(reference, name, AT))


@pytest.mark.parametrize("name", ["whole", "bare"])
@pytest.mark.parametrize("check", STRICT_CHECKS.values(), ids=STRICT_CHECKS.keys())
def test_malformed_requests_are_answered_too(ours: str, check: Any, name: str) -> None:
    check(ModelUnderTest(ours, name, AT))


def test_the_reference_has_no_errors_for_malformed_requests(reference: str) -> None:
    for name in ("malformed_json", "wrong_types", "missing_keys", "large_requests"):
        with pytest.raises(AssertionError):
            STRICT_CHECKS[name](ModelUnderTest(reference, "whole", AT))


BROKEN = {
    "info": replace(WHOLE, name="other"),
    "input_sizes": replace(WHOLE, input_sizes=(3,)),
    "evaluate": replace(WHOLE, output_sizes=(4,)),
    "evaluate_repeats": replace(
        WHOLE, evaluate=lambda blocks, calls=[]: calls.append(0) or [[float(len(calls)), 0, 0]]
    ),
    "gradient": replace(WHOLE, gradient=lambda out, into, b, s: [1.0]),
    "apply_jacobian": replace(WHOLE, apply_jacobian=lambda out, into, b, v: [1.0, 1.0, 1.0]),
    "gradient_and_jacobian_agree": replace(WHOLE, apply_jacobian=lambda out, into, b, v: [v[0], v[0], v[1]]),
}


@pytest.mark.parametrize("name", BROKEN)
def test_the_suite_finds_planted_mistakes(name: str) -> None:
    with served(BROKEN[name]) as url, pytest.raises(AssertionError):
        CHECKS[name](ModelUnderTest(url, "whole", AT))


def test_the_reference_client_gets_the_same_numbers(ours: str) -> None:
    model = umbridge.HTTPModel(ours, "whole")
    x, y = AT[0]
    assert umbridge.supported_models(ours) == ["whole", "bare"]
    assert (model.get_input_sizes(), model.get_output_sizes()) == ([2], [3])
    assert model(AT) == [[x * x, x * y, y]]
    assert model.gradient(0, 0, AT, [1.0, 10.0, 100.0]) == [2 * x + 10 * y, 10 * x + 100]
    assert model.apply_jacobian(0, 0, AT, [3.0, 4.0]) == [6 * x, 3 * y + 4 * x, 4.0]
    assert not model.supports_apply_hessian()
    with pytest.raises(Exception, match="ModelError: singular: the matrix is singular"):
        model([[2.0, 0.0]])


@pytest.mark.parametrize(
    ("x", "status", "kind", "message"),
    [
        (2.0, 500, "ModelError", "singular: the matrix is singular"),
        (1.0, 500, "ModelError", "ZeroDivisionError: by nothing"),
        (-2.0, 400, "InvalidInput", "x: got -2.0; expected at least -1. Choose another."),
    ],
)
def test_a_failing_model_is_an_error_of_the_protocol(ours: str, x: float, status: int, kind: str, message: str) -> None:
    response = ModelUnderTest(ours, "whole", AT).post("Evaluate", {"name": "whole", "input": [[x, 0.0]]})
    assert response.status_code == status
    assert response.json() == {"error": {"type": kind, "message": message}}


@pytest.mark.parametrize("values", [[float("nan"), 0.0, 0.0], [1.0, 2.0]])
def test_outputs_that_break_a_promise_are_not_passed_on(values: list[float]) -> None:
    with served(replace(WHOLE, evaluate=lambda blocks: [values])) as url:
        response = ModelUnderTest(url, "whole", AT).post("Evaluate", {"name": "whole", "input": AT})
    assert response.status_code == 500
    assert response.json()["error"]["type"] == "InvalidOutput"


def test_a_config_is_refused(ours: str) -> None:
    response = ModelUnderTest(ours, "whole", AT).post("Evaluate", {"name": "whole", "input": AT, "config": {"mesh": 1}})
    assert (response.status_code, response.json()["error"]["type"]) == (400, "InvalidInput")


def test_requests_at_once_are_all_answered() -> None:
    together = threading.Barrier(8, timeout=30)

    def waits(blocks: list[list[float]]) -> list[list[float]]:
        together.wait()
        return whole(blocks)

    with served(replace(BARE, evaluate=waits)) as url, ThreadPoolExecutor(8) as pool:
        model = ModelUnderTest(url, "bare", AT)
        answers = pool.map(lambda y: model.ask("Evaluate", input=[[0.5, y]])["output"], map(float, range(8)))
        assert list(answers) == [[[0.25, 0.5 * y, y]] for y in range(8)]


@pytest.mark.parametrize(
    "sent",
    [
        b"nonsense\r\n\r\n",
        b"GET http://[::1\r\n\r\n",
        b"GET http://[::1 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET //[::1/Info HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET * HTTP/1.1\r\nHost: localhost\r\n\r\n",
        POST + b"Content-Length: -1\r\n\r\n",
        POST + b"Content-Length: 99999999999999999999999\r\n\r\n",
        POST + b"Content-Length: " + b"0" * 20 + b"99999999999\r\n\r\n",
        POST + b"Content-Length: " + b"9" * 5001 + b"\r\n\r\n",
        POST + b"Content-Length: 2\r\nContent-Length: 3\r\n\r\n{}",
        POST + "Content-Length: ²\r\n\r\n".encode("latin-1"),
        POST + b"Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n",
        b"PUT /Evaluate HTTP/1.1\r\nHost: localhost\r\nContent-Length: 2\r\n\r\n{}",
        b"GET /" + b"a" * 70000 + b" HTTP/1.1\r\n\r\n",
        b"GET /Info HTTP/99999999999999999999.1\r\n\r\n",
        b"GET /Info HTTP/1.1\r\n" + b"a: b\r\n" * 200 + b"\r\n",
    ],
    ids=range(16),
)
def test_what_is_no_proper_request_gets_an_error_and_the_next_one_an_answer(
    ours: str, sent: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    address = httpx.URL(ours)
    with socket.create_connection((address.host, address.port or 0), timeout=10) as connection:
        connection.sendall(sent)
        connection.shutdown(socket.SHUT_WR)
        reply = b"".join(iter(lambda: connection.recv(65536), b""))
    assert set(json.loads(reply.rpartition(b"\r\n")[2])["error"]) == {"type", "message"}
    assert b" 4" in reply.partition(b"\r\n")[0] or reply.startswith((b"{", b"HTTP/1.1 5"))
    assert capfd.readouterr().err == ""
    assert ModelUnderTest(ours, "whole", AT).ask("Evaluate", input=AT)


def test_it_listens_on_this_machine_alone_unless_told_otherwise() -> None:
    with UMBridgeServer([BARE], port=0) as server:
        assert server.server_address[0] == "127.0.0.1"
        with pytest.raises(InvalidInput, match="port"):
            UMBridgeServer([BARE], port=server.server_address[1])


def test_numbers_travel_to_the_last_bit(ours: str) -> None:
    x, y = np.random.default_rng(0).standard_normal(2).clip(-0.9, 0.9).tolist()
    output = ModelUnderTest(ours, "bare", AT).ask("Evaluate", input=[[x, y]])["output"]
    assert output == [[x * x, x * y, y]]
