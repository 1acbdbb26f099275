"""Simulators behind UM-Bridge as forward models: the numbers, the options, and servers that misbehave."""

import contextlib
import gzip
import json
import pickle
import re
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.unit.models.umbridge.served import running

from strandline.models.protocol import with_sensitivities
from strandline.models.umbridge import client as client_module
from strandline.models.umbridge.answers import ServedModel, answer
from strandline.models.umbridge.model import UMBridge, UMBridgeModel
from strandline.models.umbridge.server import UMBridgeServer
from strandline.runs import RunRecord, RunRequest, attempt
from strandline.testing.models import Cantilever

BEAM = Cantilever(nodes=3)
LOAD = 1e-5


def outline(blocks: list[list[float]]) -> np.ndarray[Any, Any]:
    modulus, load = blocks[0]
    return BEAM.outline(modulus, load).points


def slopes(blocks: list[list[float]]) -> np.ndarray[Any, Any]:
    """Return d(coordinates)/d(E, load) by hand: the displacement is proportional to load/E."""
    modulus, load = blocks[0]
    unit = (BEAM.outline(1.0, 1.0).points - BEAM.outline(1.0, 0.0).points).ravel()
    return np.stack([-load / modulus**2 * unit, unit / modulus], axis=1)


POINTS = ServedModel("beam", (2,), (12,), lambda blocks: [outline(blocks).ravel().tolist()])
JACOBIAN = replace(POINTS, apply_jacobian=lambda out, into, blocks, v: (slopes(blocks) @ v).tolist())
GRADIENT = replace(POINTS, gradient=lambda out, into, blocks, s: (s @ slopes(blocks)).tolist())
COLUMNS = ServedModel("beam", (1, 1), (6, 6), lambda b: (outline([[b[1][0], b[0][0]]]).T * 1000).tolist())
SURFACE = ServedModel(
    "beam", (2,), (12, 12), lambda b: [[0.0] * 3 + [b[0][0]] + [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], TRIANGLES]
)
TRIANGLES = [float(corner) for corner in (0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3)]
Reply = Callable[["Handler", bytes], None]


class Handler(BaseHTTPRequestHandler):
    """Describes the model properly and hands Evaluate to the misbehaviour of the server."""

    def do_GET(self) -> None:
        self._reply()

    def do_POST(self) -> None:
        self._reply()

    def _reply(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        sick = not body or json.loads(body).get("input", [[0.0]])[0][0] > 500
        self.server.paths.append(self.path)  # type: ignore[attr-defined]
        if sick and self.path == self.server.sick:  # type: ignore[attr-defined]
            self.server.reply(self, body)  # type: ignore[attr-defined]
        else:
            given = answer([POINTS], self.command, self.path, body)
            self.send(given.status, json.dumps(given.content).encode())

    def send(self, status: int, body: bytes, *headers: tuple[str, str]) -> None:
        self.send_response(status)
        for name, value in (*headers, ("Content-Length", str(len(body)))):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        pass


class Hostile(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def handle_error(self, request: Any, client_address: Any) -> None:
        pass


@contextlib.contextmanager
def hostile(reply: Reply, sick: str = "/Evaluate") -> Iterator[tuple[str, list[str]]]:
    server = Hostile(("127.0.0.1", 0), Handler)
    server.reply, server.sick, server.paths = reply, sick, []  # type: ignore[attr-defined]
    with running(server) as url:
        yield url, server.paths  # type: ignore[attr-defined]


def model(url: str, **options: Any) -> UMBridgeModel:
    return UMBridge.from_options(**{"url": url, "name": "beam", "inputs": ["E", "load"]} | options)


def run(forward: UMBridgeModel, modulus: float = 400.0) -> RunRecord:
    return attempt(forward, RunRequest("key", {"E": modulus, "load": LOAD}), Path())


@pytest.mark.smoke
def test_points_columns_and_surfaces_arrive() -> None:
    expected = outline([[400.0, LOAD]])
    with running(UMBridgeServer([POINTS], port=0)) as url:
        np.testing.assert_array_equal(run(model(url)).interfaces[""].points, expected)
        assert run(model(url, interface={"closed": True})).interfaces[""].closed
        assert run(with_sensitivities(model(url))).failure_kind == "no_sensitivities"
    with running(UMBridgeServer([COLUMNS], port=0)) as url:  # several blocks, in another unit
        options = {"inputs": [["load"], ["E"]], "interface": {"shape": "columns"}, "unit": "um"}
        np.testing.assert_allclose(run(model(url, **options)).interfaces[""].points, expected, rtol=1e-14)
    with running(UMBridgeServer([SURFACE], port=0)) as url:
        surface = run(model(url, interface={"dim": 3})).interfaces[""]
        assert run(model(url, interface={"dim": 3, "shape": "columns"})).failure_kind == "protocol"
    np.testing.assert_array_equal(surface.cells, np.reshape(TRIANGLES, (-1, 3)))
    assert surface.points[1, 0] == 400.0


@pytest.mark.parametrize("served", [JACOBIAN, GRADIENT], ids=["ApplyJacobian", "Gradient"])
def test_sensitivities(served: ServedModel) -> None:
    with running(UMBridgeServer([served], port=0)) as url:
        record = run(with_sensitivities(model(url, unit="m")))
    assert record.ok
    expected = 1000 * slopes([[400.0, LOAD]])
    for number, name in enumerate(("E", "load")):
        np.testing.assert_allclose(record.sensitivities[""][name].ravel(), expected[:, number], rtol=1e-12)


def test_the_description_is_asked_once_and_the_config_sent() -> None:
    with hostile(lambda handler, body: None) as (url, paths):
        forward = model(url)
        assert run(forward).ok
        assert run(pickle.loads(pickle.dumps(forward))).ok
        assert run(model(url, config={"mesh": 1})).failure_kind == "model_error"
    asked = ["/Info", "/ModelInfo", "/InputSizes", "/OutputSizes", "/Evaluate", "/Evaluate"]
    assert paths[: len(asked)] == asked


def sends(status: int, text: str | bytes, *headers: tuple[str, str]) -> Reply:
    body = text.encode() if isinstance(text, str) else text
    return lambda handler, _: handler.send(status, body, *headers)


def hangs(handler: Handler, body: bytes) -> None:
    time.sleep(5.0)


def drips(handler: Handler, body: bytes) -> None:
    """Send a header that never ends, a byte every tenth of a second."""
    handler.wfile.write(b"HTTP/1.1 200 OK\r\nX-Slow: ")
    for _ in range(50):
        handler.wfile.write(b"a")
        time.sleep(0.1)


def closes(handler: Handler, body: bytes) -> None:
    handler.connection.shutdown(socket.SHUT_RDWR)


def breaks_off(handler: Handler, body: bytes) -> None:
    handler.wfile.write(b'HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n{"output": [[')
    closes(handler, body)


def floods(handler: Handler, body: bytes) -> None:
    """Promise a gigabyte and send as much of it as is taken."""
    handler.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Length: 1000000000\r\n\r\n")
    for _ in range(1000):
        handler.wfile.write(b" " * 1_000_000)


TWELVE = json.dumps([0.5] * 11)[:-1]
MISHAPS: dict[str, tuple[Reply, str, str]] = {
    "hangs": (hangs, "timeout", "no answer of .* within 1 s"),
    "drips": (drips, "timeout", "no answer of .* within 1 s"),
    "raises, with an error": (
        sends(500, '{"error": {"type": "ModelError", "message": "singular"}}'),
        "model_error",
        "ModelError'?: singular",
    ),
    "raises, with a page": (
        sends(500, "<html><h1>500</h1><p>Internal  error"),
        "model_error",
        "HTTP 500 without a reason: 500 Internal error",
    ),
    "refuses": (sends(400, '{"error": {"type": "InvalidInput", "message": "E"}}'), "model_error", "InvalidInput"),
    "an error with status 200": (sends(200, '{"error": {"type": "X", "message": "m"}}'), "model_error", "X"),
    "unknown model": (sends(400, '{"error": {"type": "ModelNotFound", "message": "m"}}'), "protocol", "ModelNotFound"),
    "a page": (sends(200, "<html>Welcome</html>"), "protocol", "no JSON object: Welcome"),
    "not found": (sends(404, "nothing here"), "protocol", "HTTP 404: nothing here"),
    "NaN": (sends(200, f'{{"output": [{TWELVE}, NaN]]}}'), "non_finite", "1 of 12"),
    "nan of Python": (sends(200, f'{{"output": [{TWELVE}, nan]] }}'), "non_finite", "1 of 12"),
    "-inf of Python": (sends(200, f'{{"output": [{TWELVE}, -inf]] }}'), "non_finite", "1 of 12"),
    "null": (sends(200, f'{{"output": [{TWELVE}, null]]}}'), "non_finite", "1 of 12"),
    "too large": (sends(200, f'{{"output": [{TWELVE}, 1e999]]}}'), "non_finite", "1 of 12"),
    "text": (sends(200, f'{{"output": [{TWELVE}, "1"]]}}'), "protocol", "'1' among the numbers"),
    "truth": (sends(200, f'{{"output": [{TWELVE}, true]]}}'), "protocol", "True among the numbers"),
    "half a JSON": (sends(200, f'{{"output": [{TWELVE}'), "protocol", "no JSON object"),
    "deep JSON": (sends(200, "[" * 100000), "protocol", "no JSON object"),
    "wrong length": (sends(200, f'{{"output": [{TWELVE}]]}}'), "protocol", "11 numbers; expected 12"),
    "wrong blocks": (sends(200, '{"output": []}'), "protocol", "expected a list of 1 blocks"),
    "no output": (sends(200, "{}"), "protocol", "expected a list of 1 blocks"),
    "a flat output": (sends(200, f'{{"output": {TWELVE}]}}'), "protocol", "expected a list of 1 blocks"),
    "closes": (closes, "connection", "broke off"),
    "breaks off": (breaks_off, "connection", "broke off"),
    "redirects": (
        sends(307, "", ("Location", "http://127.0.0.1:1/Evaluate")),
        "protocol",
        "redirects Evaluate to .*, which is not followed",
    ),
    "floods": (floods, "protocol", "more than 64 MB"),
    "a bomb": (
        sends(200, gzip.compress(b" " * (client_module.LARGEST_ANSWER + 1)), ("Content-Encoding", "gzip")),
        "protocol",
        "more than 64 MB",
    ),
    "a broken bomb": (sends(200, b"nonsense", ("Content-Encoding", "gzip")), "protocol", "cannot be unpacked"),
}


def test_what_a_server_says_behind_the_first_line_is_the_log() -> None:
    said = "timeout: killed\nlast lines of its log:\n" + "a\n" * client_module.LONGEST_LOG + "Newton diverges"
    reply = sends(500, json.dumps({"error": {"type": "ModelError", "message": said}}))
    with hostile(reply) as (url, _):
        record = run(model(url), 600.0)
    assert record.failure_kind == "model_error"
    assert str(record.message).splitlines()[0] == "the server says 'ModelError': timeout: killed"
    assert str(record.message).endswith("a\nNewton diverges")
    assert record.log.splitlines()[-2:] == ["a", "Newton diverges"]
    assert len(record.log) <= client_module.LONGEST_LOG


KINDS = ("model_error", "protocol", "non_finite", "connection")


@pytest.mark.parametrize("kind", ["timeout", *(pytest.param(kind, marks=pytest.mark.smoke) for kind in KINDS)])
def test_a_server_that_misbehaves_costs_the_runs_that_it_hits(kind: str) -> None:
    for reply, message in [(reply, words) for reply, failure, words in MISHAPS.values() if failure == kind]:
        with hostile(reply) as (url, paths):
            forward = model(url, timeout=1.0 if kind == "timeout" else 30.0)
            records = [run(forward, modulus) for modulus in (300.0, 600.0, 400.0)]
            assert paths.count("/Evaluate") == 3
        assert [record.ok for record in records] == [True, False, True]
        assert records[1].failure_kind == kind
        assert records[1].state in (("failed", "timeout") if kind == "timeout" else ("failed",))
        assert records[1].seconds < 4.0
        assert re.search(message, str(records[1].message)), records[1].message
        np.testing.assert_array_equal(records[2].interfaces[""].points, outline([[400.0, LOAD]]))


def test_a_server_of_something_else_is_told() -> None:
    for text, message in (
        ('{"protocolVersion": 0.9, "models": ["beam"]}', "speaks version 0.9"),
        ('{"models": ["beam"]}', "speaks version None"),
        ('{"protocolVersion": 1.0, "models": ["bream"]}', "no model called 'beam'; it offers .*bream"),
        ("<html>It works!</html>", "no JSON object: It works!"),
    ):
        with hostile(sends(200, text), "/Info") as (url, _):
            record = run(model(url))
        assert record.failure_kind == "protocol"
        assert re.search(message, str(record.message)), record.message


def test_inputs_that_are_not_the_models_are_told() -> None:
    with running(UMBridgeServer([POINTS], port=0)) as url:
        sizes = run(model(url, inputs=[["E"], ["load"]]))
        names = run(model(url, inputs=["E", "force"]))
    assert (sizes.failure_kind, names.failure_kind) == ("protocol", "inputs")
    assert "takes blocks of [2] inputs" in str(sizes.message)
    assert "force, load" in str(names.message)


def test_no_server() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        record = run(model(f"http://127.0.0.1:{taken.getsockname()[1]}"))
    assert record.failure_kind == "connection"
    assert "no UM-Bridge server answers at http://127.0.0.1:" in str(record.message)


def test_proxies_of_the_environment_are_passed_by(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:1")
    with running(UMBridgeServer([POINTS], port=0)) as url:
        assert run(model(url)).ok
