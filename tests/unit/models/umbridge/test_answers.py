"""What the server of UM-Bridge answers, without a connection: its own suite, and mistakes that the suite must find."""

import json
from dataclasses import dataclass, replace
from typing import Any

import httpx
import numpy as np
import pytest
from tests.unit.models.umbridge.served import AT, BARE, WHOLE

from strandline.models.umbridge.answers import ServedModel, answer
from strandline.testing.umbridge import CHECKS, STRICT_CHECKS, ModelUnderTest


@dataclass(frozen=True)
class Direct(ModelUnderTest):
    """Calls the server's function in place of a server."""

    models: tuple[ServedModel, ...] = (WHOLE, BARE)

    def get(self, endpoint: str) -> httpx.Response:
        return self._answered("GET", endpoint, b"")

    def post(self, endpoint: str, content: Any) -> httpx.Response:
        return self._answered("POST", endpoint, content if isinstance(content, bytes) else json.dumps(content).encode())

    def _answered(self, method: str, endpoint: str, body: bytes) -> httpx.Response:
        given = answer(self.models, method, f"/{endpoint}", body)
        return httpx.Response(given.status, json=given.content)


def under_test(name: str = "whole", *models: ServedModel) -> Direct:
    return Direct("", name, AT, models or (WHOLE, BARE))


@pytest.mark.parametrize("name", ["whole", "bare"])
def test_it_passes_its_own_suite(name: str) -> None:
    for key, check in {**CHECKS, **STRICT_CHECKS}.items():
        if key != "large_requests":  # refused before they are read
            check(under_test(name))


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


def test_the_suite_finds_planted_mistakes() -> None:
    for name, model in BROKEN.items():
        with pytest.raises(AssertionError):
            CHECKS[name](under_test("whole", model))


def test_a_failing_model_is_an_error_of_the_protocol() -> None:
    for x, status, kind, message in (
        (2.0, 500, "ModelError", "singular: the matrix is singular"),
        (1.0, 500, "ModelError", "ZeroDivisionError: by nothing"),
        (-2.0, 400, "InvalidInput", "x: got -2.0; expected at least -1. Choose another."),
    ):
        response = under_test().post("Evaluate", {"name": "whole", "input": [[x, 0.0]]})
        assert response.status_code == status
        assert response.json() == {"error": {"type": kind, "message": message}}


def test_outputs_that_break_a_promise_are_not_passed_on_and_a_config_is_refused() -> None:
    for values in ([float("nan"), 0.0, 0.0], [1.0, 2.0]):
        broken = replace(WHOLE, evaluate=lambda blocks, values=values: [values])
        response = under_test("whole", broken).post("Evaluate", {"name": "whole", "input": AT})
        assert (response.status_code, response.json()["error"]["type"]) == (500, "InvalidOutput")
    response = under_test().post("Evaluate", {"name": "whole", "input": AT, "config": {"mesh": 1}})
    assert (response.status_code, response.json()["error"]["type"]) == (400, "InvalidInput")


def test_numbers_travel_to_the_last_bit() -> None:
    x, y = np.random.default_rng(0).standard_normal(2).clip(-0.9, 0.9).tolist()
    assert under_test("bare").ask("Evaluate", input=[[x, y]])["output"] == [[x * x, x * y, y]]
