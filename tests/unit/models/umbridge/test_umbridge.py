"""UM-Bridge without a connection: what the server answers and whom it lets in; a client's options, and interfaces."""

import base64
import json
import socket
from dataclasses import dataclass, replace
from email.message import Message

import httpx
import numpy as np
import pytest
from tests.unit.models.umbridge.served import AT, TOKEN, WHOLE

from strandline.foundations import ForwardModelError, InvalidInput
from strandline.models.protocol import with_sensitivities
from strandline.models.umbridge.answers import Rejected, ServedModel, answer
from strandline.models.umbridge.model import BlockLayout, UMBridgeModel
from strandline.models.umbridge.server import Access
from strandline.studies.keys.parse import made
from strandline.testing.umbridge import CHECKS, ModelUnderTest


@dataclass(frozen=True)
class Direct(ModelUnderTest):
    """Calls the server's function in place of a server."""

    models: tuple[ServedModel, ...]

    def get(self, endpoint):
        return self._answered("GET", endpoint, b"")

    def post(self, endpoint, content):
        return self._answered("POST", endpoint, content if isinstance(content, bytes) else json.dumps(content).encode())

    def _answered(self, method, endpoint, body):
        given = answer(self.models, method, f"/{endpoint}", body)
        return httpx.Response(given.status, json=given.content)


def under_test(**changes):
    return Direct("", "whole", AT, (replace(WHOLE, **changes),))


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
            CHECKS[name](under_test(**changes))


def test_a_failing_model_and_broken_promises_are_errors_of_the_protocol():
    for changes, asked, code, kind, message in (
        ({}, {"input": [[2.0, 0.0]]}, 500, "ModelError", "singular: the matrix is singular"),
        ({}, {"input": [[1.0, 0.0]]}, 500, "ModelError", "ZeroDivisionError: by nothing"),
        ({}, {"input": [[-2.0, 0.0]]}, 400, "InvalidInput", "x: got -2.0; expected at least -1. Choose another."),
        ({}, {"config": {"mesh": 1}}, 400, "InvalidInput", ""),
        ({"evaluate": lambda blocks: [[float("nan"), 0.0, 0.0]]}, {}, 500, "InvalidOutput", ""),
        ({"evaluate": lambda blocks: [[1.0, 2.0]]}, {}, 500, "InvalidOutput", ""),
    ):
        response = under_test(**changes).post("Evaluate", {"name": "whole", "input": AT} | asked)
        error = response.json()["error"]
        assert (response.status_code, error["type"]) == (code, kind)
        assert message in error["message"]


def status(door, **headers):
    """Return the HTTP status with which a request is refused, 200 if it is let in."""
    message = Message()
    for name, text in ({"Host": "localhost", "Content-Type": "application/json"} | headers).items():
        if text:
            message[name] = text
    try:
        door.check("POST", message)
    except Rejected as refused:
        return refused.answer.status if TOKEN not in str(refused) else None
    return 200


def test_it_answers_to_its_own_addresses_alone():
    """A page whose domain points here sends another name."""
    door = Access.of("127.0.0.1")
    for host in ("localhost", "LOCALHOST:4242", "localhost.", "127.0.0.1:1", "127.1.2.3", "[::1]:80"):
        assert status(door, Host=host) == 200
    for host in ("attacker.example", "attacker.example:4242", "10.0.0.1", "[fe80::1]", "", "localhost@x"):
        assert status(door, Host=host) == 403
    network = Access.of("0.0.0.0")
    names = ("10.0.0.1:4242", socket.gethostname(), "attacker.example")
    assert [status(network, Host=host) for host in names] == [200, 200, 403]


def test_pages_and_forms_are_refused_unless_they_are_allowed():
    door, page = Access.of("127.0.0.1"), "https://example.org"
    for origin in (page, "null", "http://localhost:4242"):
        assert status(door, Origin=origin) == 403
    for kind in ("text/plain", "multipart/form-data; boundary=x"):
        assert status(door, **{"Content-Type": kind}) == 415
    assert status(door, **{"Content-Type": "Application/JSON; charset=utf-8"}) == 200
    allowed = Access.of("127.0.0.1", names=["Cell.example"], origins=[page])
    assert status(allowed, Host="cell.example:80", Origin=page) == 200
    assert status(allowed, Host="other.example") == 403


def test_a_token_is_needed_as_bearer_or_as_the_password_of_the_address():
    door = Access.of("127.0.0.1", token=TOKEN)
    wrong, right = (base64.b64encode(f"any:{token}".encode()).decode() for token in (f"{TOKEN}x", TOKEN))
    for sent in ("", f"Bearer {TOKEN}x", "Basic !", f"Basic {wrong}", f"Other {TOKEN}"):
        assert status(door, Authorization=sent) == 401
    for sent in (f"Bearer {TOKEN}", f"Basic {right}"):
        assert status(door, Authorization=sent) == 200
    for token in ("0123456789 abcdef", "0123456789abcdéf", TOKEN[:-1]):
        with pytest.raises(InvalidInput, match="at least 16 printable ASCII characters") as caught:
            Access.of("127.0.0.1", token=token)
        assert token not in str(caught.value)


def model(**options):
    given = {"url": "http://127.0.0.1:1", "name": "beam", "inputs": ["E", "load"]} | options
    return made(UMBridgeModel, given, "model.umbridge")


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


WRONG = [
    ({"url": "127.0.0.1:4242"}, "url"),
    ({"inputs": ["E", "E"]}, "inputs"),
    ({"unit": "inch"}, "unit"),
    ({"at_once": 0}, "at_once"),
    ({"config": {"a": float("nan")}}, "config"),
    ({"interface": {"shape": "mesh"}}, "interface.shape"),
    ({"interface": {"dim": 3, "closed": True}}, "interface.closed"),
]


def test_wrong_options_are_refused_before_anything_is_sent():
    for options, what in WRONG:
        with pytest.raises(InvalidInput) as caught:
            model(**options)
        assert caught.value.what.removeprefix("model.umbridge.") == what


TRIANGLES = np.array([0.0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3])
CORNERS = np.array([0.0, 0, 0, 4, 0, 0, 0, 1, 0, 0, 0, 1])


def test_blocks_that_hold_no_interface_are_told():
    for layout, blocks, words in (
        (BlockLayout(), [np.ones(3)], "2 numbers for each point"),
        (BlockLayout("columns"), [np.ones(3), np.ones(2)], "as many numbers"),
        (BlockLayout(dim=3), [CORNERS], "a block with the triangles"),
        (BlockLayout(dim=3), [CORNERS, TRIANGLES + 0.5], "three whole numbers"),
    ):
        with pytest.raises(ForwardModelError, match=words) as caught:
            layout.interface(blocks, 1.0)
        assert caught.value.kind == "protocol"
