"""Simulators behind UM-Bridge as forward models: the numbers, the options, and servers that misbehave."""

import contextlib
import gzip
import json
import re
import socket
import time
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from tests.unit.models.umbridge.served import running, served

from strandline.foundations import ForwardModelError
from strandline.models.protocol import with_sensitivities
from strandline.models.umbridge import client as client_module
from strandline.models.umbridge.answers import ServedModel, answer
from strandline.models.umbridge.model import UMBridgeModel
from strandline.runs import RunRequest, attempt
from strandline.studies.keys.parse import made
from strandline.testing.models import Cantilever, TwoLoads

BEAM = Cantilever(nodes=3)
LOAD = 1e-5


def outline(blocks):
    return BEAM.outline(*blocks[0]).points


def slopes(blocks):
    found = TwoLoads(BEAM, sensitivities=True)(dict(zip(("E", "load"), blocks[0], strict=True)), Path())
    return np.stack([found.sensitivities["light"][name].ravel() for name in ("E", "load")], axis=1)


POINTS = ServedModel("beam", (2,), (12,), lambda blocks: [outline(blocks).ravel().tolist()])
JACOBIAN = replace(POINTS, apply_jacobian=lambda out, into, blocks, v: (slopes(blocks) @ v).tolist())
GRADIENT = replace(POINTS, gradient=lambda out, into, blocks, s: (s @ slopes(blocks)).tolist())
COLUMNS = ServedModel("beam", (1, 1), (6, 6), lambda b: (outline([[b[1][0], b[0][0]]]).T * 1000).tolist())
TRIANGLES = [float(corner) for corner in (0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3)]
SURFACE = ServedModel(
    "beam", (2,), (12, 12), lambda b: [[0.0] * 3 + [b[0][0]] + [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], TRIANGLES]
)


class Handler(BaseHTTPRequestHandler):
    """Describes the model properly and hands Evaluate to the misbehaviour of the server."""

    def do_GET(self):
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if self.path == "/Evaluate" and json.loads(body)["input"][0][0] > 500:
            self.server.reply(self, body)
        else:
            given = answer([POINTS], self.command, self.path, body)
            self.send(given.status, json.dumps(given.content).encode())

    do_POST = do_GET

    def send(self, status, body, *headers):
        self.send_response(status)
        for name, value in (*headers, ("Content-Length", str(len(body)))):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *told):
        pass


class Hostile(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    handle_error = Handler.log_message


@contextlib.contextmanager
def hostile(reply):
    server = Hostile(("127.0.0.1", 0), Handler)
    server.reply = reply
    with running(server) as url:
        yield url


def model(url, **options):
    return made(UMBridgeModel, {"url": url, "name": "beam", "inputs": ["E", "load"]} | options, "model.umbridge")


def run(forward, modulus=400.0):
    return attempt(forward, RunRequest("key", {"E": modulus, "load": LOAD}), Path())


@pytest.mark.smoke
def test_points_columns_and_surfaces_arrive():
    expected = outline([[400.0, LOAD]])
    with served(POINTS) as url:
        np.testing.assert_array_equal(run(model(url)).interfaces[""].points, expected)
        assert run(model(url, interface={"closed": True})).interfaces[""].closed
        assert run(with_sensitivities(model(url))).failure_kind == "no_sensitivities"
        assert run(model(url, config={"mesh": 1})).failure_kind == "model_error"  # it takes none
    with served(COLUMNS) as url:  # several blocks, in another unit
        options = {"inputs": [["load"], ["E"]], "interface": {"shape": "columns"}, "unit": "um"}
        np.testing.assert_allclose(run(model(url, **options)).interfaces[""].points, expected, rtol=1e-14)
    with served(SURFACE) as url:
        surface = run(model(url, interface={"dim": 3})).interfaces[""]
    np.testing.assert_array_equal(surface.cells, np.reshape(TRIANGLES, (-1, 3)))
    assert surface.points[1, 0] == 400.0


@pytest.mark.parametrize("offering", [JACOBIAN, GRADIENT])
def test_sensitivities(offering):
    with served(offering) as url:
        record = run(with_sensitivities(model(url, unit="m")))
    expected = 1000 * slopes([[400.0, LOAD]])
    for number, name in enumerate(("E", "load")):
        np.testing.assert_allclose(record.sensitivities[""][name].ravel(), expected[:, number], rtol=1e-12)


def sends(status, text, *headers):
    body = text.encode() if isinstance(text, str) else text
    return lambda handler, _: handler.send(status, body, *headers)


def says(status, kind, message="m"):
    return sends(status, json.dumps({"error": {"type": kind, "message": message}}))


def twelfth(text):
    """Return what sends eleven numbers and a text in place of the last."""
    return sends(200, f'{{"output": [[{"0.5, " * 11}{text}]]}}')


def drips(handler, body):
    """Send a header that never ends, a byte every tenth of a second."""
    handler.wfile.write(b"HTTP/1.1 200 OK\r\nX-Slow: ")
    for _ in range(50):
        handler.wfile.write(b"a")
        time.sleep(0.1)


def late(handler, body):
    time.sleep(0.15)
    handler.send(200, b"{}")


def breaks_off(handler, body):
    handler.wfile.write(b'HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n{"output": [[')
    handler.connection.shutdown(socket.SHUT_RDWR)


ZIPPED = ("Content-Encoding", "gzip")
BOMB = gzip.compress(b" " * (client_module.LARGEST_ANSWER + 1))
MISHAPS = {
    "model_error": [
        (says(500, "ModelError", "singular"), "ModelError'?: singular"),
        (sends(500, "<h1>500</h1><p>Internal  error"), "HTTP 500 without a reason: 500 Internal error"),
    ],
    "protocol": [
        (says(400, "ModelNotFound"), "ModelNotFound"),
        (sends(200, "<html>Welcome</html>"), "no JSON object: Welcome"),
        (twelfth('"1"'), "'1' among the numbers"),
        (twelfth("0.5, 0.5"), "13 numbers; expected 12"),
        (sends(307, "", ("Location", "http://127.0.0.1:1/")), "redirects Evaluate to .*, which is not followed"),
        (sends(200, BOMB, ZIPPED), "more than 64 MB"),
        (sends(200, b"nonsense", ZIPPED), "cannot be unpacked"),
    ],
    "non_finite": [(twelfth(text), "1 of 12") for text in ("NaN", "nan", "-inf", "null", "1e999")],
    "connection": [(breaks_off, "broke off")],
}


@pytest.mark.smoke
@pytest.mark.parametrize("kind", MISHAPS)
def test_a_server_that_misbehaves_costs_the_runs_that_it_hits(kind):
    for reply, message in MISHAPS[kind]:
        with hostile(reply) as url:
            forward = model(url, timeout=30.0)
            records = [run(forward, modulus) for modulus in (300.0, 600.0, 400.0)]
        assert [record.ok for record in records] == [True, False, True]
        assert records[1].failure_kind == kind
        assert records[1].state == ("killed" if kind == "connection" else "failed")
        assert re.search(message, str(records[1].message)), records[1].message
        np.testing.assert_array_equal(records[2].interfaces[""].points, outline([[400.0, LOAD]]))


@pytest.mark.smoke
@pytest.mark.parametrize(
    ("reply", "timeout", "found"), [(late, 0.1, "it came after"), (drips, 0.02, "none came in 0.[2-9]")]
)
def test_an_evaluation_that_takes_too_long_fails_once_the_server_is_free_or_never_will_be(reply, timeout, found):
    with hostile(reply) as url, pytest.raises(ForwardModelError, match=rf"within {timeout} s; {found}") as caught:
        client_module.Client(url, "beam", timeout=timeout).evaluate([[600.0, LOAD]], (12,))
    assert caught.value.state == "timeout"


def test_what_a_server_says_behind_the_first_line_is_the_log():
    said = "timeout: killed\nlast lines of its log:\n" + "a\n" * client_module.LONGEST_LOG + "Newton diverges"
    with hostile(says(500, "ModelError", said)) as url:
        record = run(model(url), 600.0)
    assert str(record.message).splitlines()[0] == "the server says 'ModelError': timeout: killed"
    assert record.log.splitlines()[-2:] == ["a", "Newton diverges"]
    assert len(record.log) <= client_module.LONGEST_LOG


def test_wrong_inputs_and_no_server_are_told_and_proxies_of_the_environment_passed_by(monkeypatch):
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:1")
    with served(POINTS) as url:
        sizes = run(model(url, inputs=[["E"], ["load"]]))
        names = run(model(url, inputs=["E", "force"]))
        absent = run(model(url, name="bream"))
        assert run(model(url)).ok
    nobody = run(model(url))
    assert (sizes.failure_kind, names.failure_kind, nobody.failure_kind) == ("protocol", "inputs", "connection")
    assert "takes blocks of [2] inputs" in str(sizes.message)
    assert "force, load" in str(names.message)
    assert "no model called 'bream'; it offers" in str(absent.message)
    assert f"no UM-Bridge server answers at {url}" in str(nobody.message)
