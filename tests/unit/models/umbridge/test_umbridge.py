"""UM-Bridge without a connection: what the server answers and whom it lets in; a client's options, and interfaces."""

import base64
import json
import socket
from dataclasses import dataclass, replace
from email.message import Message

import httpx
import numpy as np
import pytest
from tests.unit.models.umbridge.served import AT, BARE, TOKEN, WHOLE

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.protocol import declared_inputs, with_sensitivities
from strandline.models.umbridge.answers import Refused, ServedModel, answer
from strandline.models.umbridge.door import Door
from strandline.models.umbridge.layout import Layout, flattened
from strandline.models.umbridge.model import UMBridge
from strandline.testing.umbridge import CHECKS, STRICT_CHECKS, ModelUnderTest

# --- answers


@dataclass(frozen=True)
class Direct(ModelUnderTest):
    """Calls the server's function in place of a server."""

    models: tuple[ServedModel, ...] = (WHOLE, BARE)

    def get(self, endpoint):
        return self._answered("GET", endpoint, b"")

    def post(self, endpoint, content):
        return self._answered("POST", endpoint, content if isinstance(content, bytes) else json.dumps(content).encode())

    def _answered(self, method, endpoint, body):
        given = answer(self.models, method, f"/{endpoint}", body)
        return httpx.Response(given.status, json=given.content)


def under_test(name="whole", *models):
    return Direct("", name, AT, models or (WHOLE, BARE))


@pytest.mark.parametrize("name", ["whole", "bare"])
def test_it_passes_its_own_suite(name):
    for key, check in {**CHECKS, **STRICT_CHECKS}.items():
        if key != "large_requests":  # refused before they are read
            check(under_test(name))


COUNT = iter(range(99))
BROKEN = {
    "info": {"name": "other"},
    "input_sizes": {"input_sizes": (3,)},
    "evaluate": {"output_sizes": (4,)},
    "evaluate_repeats": {"evaluate": lambda blocks: [[float(next(COUNT)), 0.0, 0.0]]},
    "gradient": {"gradient": lambda out, into, b, s: [1.0]},
    "apply_jacobian": {"apply_jacobian": lambda out, into, b, v: [1.0, 1.0, 1.0]},
    "gradient_and_jacobian_agree": {"apply_jacobian": lambda out, into, b, v: [v[0], v[0], v[1]]},
}


def test_the_suite_finds_planted_mistakes():
    for name, changes in BROKEN.items():
        with pytest.raises(AssertionError):
            CHECKS[name](under_test("whole", replace(WHOLE, **changes)))


def error_of(asked, *models):
    response = under_test("whole", *models).post("Evaluate", {"name": "whole", "input": AT} | asked)
    return response.status_code, response.json()["error"]


def test_a_failing_model_is_an_error_of_the_protocol():
    for x, status, kind, message in (
        (2.0, 500, "ModelError", "singular: the matrix is singular"),
        (1.0, 500, "ModelError", "ZeroDivisionError: by nothing"),
        (-2.0, 400, "InvalidInput", "x: got -2.0; expected at least -1. Choose another."),
    ):
        assert error_of({"input": [[x, 0.0]]}) == (status, {"type": kind, "message": message})


def test_outputs_that_break_a_promise_are_not_passed_on_and_a_config_is_refused():
    for values in ([float("nan"), 0.0, 0.0], [1.0, 2.0]):
        status, error = error_of({}, replace(WHOLE, evaluate=lambda blocks, values=values: [values]))
        assert (status, error["type"]) == (500, "InvalidOutput")
    status, error = error_of({"config": {"mesh": 1}})
    assert (status, error["type"]) == (400, "InvalidInput")


# --- who is let in


def status(door, **headers):
    """Return the HTTP status with which a request is refused, 200 if it is let in."""
    message = Message()
    for name, text in ({"Host": "localhost", "Content-Type": "application/json"} | headers).items():
        if text:
            message[name] = text
    try:
        door.check("POST", message)
    except Refused as refused:
        return refused.status if TOKEN not in str(refused) else None
    return 200


def test_it_answers_to_its_own_addresses_alone():
    """A page whose domain points here sends another name."""
    door = Door.of("127.0.0.1")
    for host in ("localhost", "LOCALHOST:4242", "localhost.", "127.0.0.1:1", "127.1.2.3", "[::1]:80"):
        assert status(door, Host=host) == 200
    for host in ("attacker.example", "attacker.example:4242", "10.0.0.1", "[fe80::1]", "", "localhost@x"):
        assert status(door, Host=host) == 403
    network = Door.of("0.0.0.0")
    names = ("10.0.0.1:4242", socket.gethostname(), "attacker.example")
    assert [status(network, Host=host) for host in names] == [200, 200, 403]


def test_pages_and_forms_are_refused_unless_they_are_allowed():
    door, page = Door.of("127.0.0.1"), "https://example.org"
    for origin in (page, "null", "http://localhost:4242"):
        assert status(door, Origin=origin) == 403
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x"):
        assert status(door, **{"Content-Type": kind}) == 415
    assert status(door, **{"Content-Type": "Application/JSON; charset=utf-8"}) == 200
    allowed = Door.of("127.0.0.1", names=["Cell.example"], origins=[page])
    assert status(allowed, Host="cell.example:80", Origin=page) == 200
    assert status(allowed, Host="other.example") == 403


def test_a_token_is_needed_as_bearer_or_as_the_password_of_the_address():
    door = Door.of("127.0.0.1", token=TOKEN)
    wrong, right = (base64.b64encode(f"any:{token}".encode()).decode() for token in (f"{TOKEN}x", TOKEN))
    for sent in ("", f"Bearer {TOKEN}x", "Basic !", f"Basic {wrong}", f"Other {TOKEN}"):
        assert status(door, Authorization=sent) == 401
    for sent in (f"Bearer {TOKEN}", f"Basic {right}"):
        assert status(door, Authorization=sent) == 200
    for token in ("short", "0123456789 abcdef", "0123456789abcdéf", "0123456789abcde\n", TOKEN[:-1]):
        with pytest.raises(InvalidInput, match="at least 16 printable ASCII characters") as caught:
            Door.of("127.0.0.1", token=token)
        assert token not in str(caught.value)


# --- a model behind a server


def model(**options):
    return UMBridge.from_options(**{"url": "http://127.0.0.1:1", "name": "beam", "inputs": ["E", "load"]} | options)


def test_the_address_is_no_part_of_the_fingerprint_and_what_changes_results_is():
    one = model()
    assert model(url="http://localhost:2/", timeout=5.0).fingerprint == one.fingerprint
    assert with_sensitivities(one).fingerprint == one.fingerprint
    others = [
        {"name": "other"},
        {"inputs": ["load", "E"]},
        {"inputs": [["E"], ["load"]]},
        {"config": {"mesh": 2}},
        {"version": 2},
        {"unit": "um"},
        {"interface": {"shape": "columns"}},
    ]
    assert len({one.fingerprint, *(model(**changes).fingerprint for changes in others)}) == len(others) + 1


def test_units_are_declared_where_all_are_given():
    declared = declared_inputs(model(inputs=[{"E": "Pa"}, {"nu": 1}]))
    assert [(item.name, item.unit) for item in declared] == [("E", "Pa"), ("nu", "1")]
    assert declared_inputs(model(inputs=[{"E": "Pa"}, "nu"])) == ()


def test_wrong_options_are_refused_before_anything_is_sent(monkeypatch):
    for options, what in (
        *(({"url": url}, "url") for url in ("127.0.0.1:4242", "ftp://127.0.0.1", "http://")),
        *(({"timeout": seconds}, "timeout") for seconds in (0.0, float("nan"))),
        *(({"inputs": names}, "inputs") for names in ([], "E", ["E", "E"], [["E"], []], [1])),
        ({"unit": "inch"}, "unit"),
        *(({"config": config}, "config") for config in ([1], {"a": float("nan")})),
        ({"interface": {"shape": "mesh"}}, "interface.shape"),
        ({"interface": {"dim": 4}}, "interface.dim"),
        ({"interface": {"dim": 3, "closed": True}}, "interface.closed"),
        ({"interface": {"form": "points"}}, "interface"),
    ):
        with pytest.raises(InvalidInput) as caught:
            model(**options)
        assert caught.value.what == what
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InvalidInput, match=r'pip install "strandline\[umbridge\]"'):
        model()


TRIANGLES = np.array([0.0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3])
CORNERS = np.array([0.0, 0, 0, 4, 0, 0, 0, 1, 0, 0, 0, 1])


def test_blocks_become_an_interface():
    points = Layout().interface([np.array([0.0, 0.0, 1.0, 2.0])], 1e-3)
    np.testing.assert_array_equal(points.points, [[0.0, 0.0], [1e-3, 2e-3]])
    assert flattened(points) == [[0.0, 0.0, 1e-3, 2e-3]]
    columns = Layout("columns", closed=True).interface([np.array([0.0, 1, 1]), np.array([0.0, 0, 1])], 1.0)
    assert columns.closed
    np.testing.assert_array_equal(columns.points, [[0, 0], [1, 0], [1, 1]])
    surface = Layout(dim=3).interface([CORNERS, TRIANGLES], 1.0)
    np.testing.assert_array_equal(surface.cells, TRIANGLES.reshape(-1, 3))
    assert flattened(surface) == [CORNERS.tolist(), TRIANGLES.tolist()]


def test_blocks_that_hold_no_interface_are_told():
    for layout, blocks, words in (
        (Layout(), [], "at least 1 blocks"),
        (Layout(), [np.ones(3)], "2 numbers for each point"),
        (Layout("columns"), [np.ones(3)], "at least 2 blocks"),
        (Layout("columns"), [np.ones(3), np.ones(2)], "as many numbers"),
        (Layout(dim=3), [CORNERS], "a block with the triangles"),
        (Layout("columns", dim=3), [np.arange(4.0)] * 4, "three whole numbers"),
        (Layout(dim=3), [CORNERS, TRIANGLES + 0.5], "three whole numbers"),
    ):
        with pytest.raises(ForwardModelError, match=words) as caught:
            layout.interface(blocks, 1.0)
        assert caught.value.kind == "protocol"
