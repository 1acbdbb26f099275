"""What `strandline serve` answers for a study: interfaces, log-likelihoods, slopes and mistakes."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from strandline.errors import InvalidStudy
from strandline.interface import Interface
from strandline.models.protocol import Simulation
from strandline.models.umbridge.answers import ServedModel, answer
from strandline.runs import RunRecord, RunRequest, attempt
from strandline.studies import Study, load_study
from strandline.studies.serve import differentiating, served_models
from strandline.testing.models import Cantilever, TwoLoads
from strandline.testing.studies import beam, write_study


def local(model: Any) -> Any:
    return lambda inputs: attempt(model, RunRequest("", dict(inputs)), Path())


def evaluate(models: tuple[ServedModel, ...], name: str, *values: float) -> tuple[int, Any]:
    body = f'{{"name": "{name}", "input": [{list(values)}]}}'.encode()
    given = answer(models, "POST", "/Evaluate", body)
    return given.status, given.content


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return load_study(write_study(tmp_path))


def test_a_failing_solve_is_a_model_error(study: Study) -> None:
    models = served_models(study, local(beam), outside=True)
    status, content = evaluate(models, "interface", 0.001, 0.0)
    assert (status, content["error"]["type"]) == (500, "ModelError")
    assert content["error"]["message"].startswith("large_deflection: the tip would move by")


def test_inputs_outside_the_boxes_are_refused_unless_asked_for(study: Study) -> None:
    low, high = study.space["E"].interval
    models = served_models(study, local(beam))
    for inside in (low, high):
        assert evaluate(models, "interface", inside, 0.0)[0] == 200
    for name in ("interface", "log_likelihood"):
        status, content = evaluate(models, name, 1.01 * high, 0.0)
        assert (status, content["error"]["type"]) == (400, "InvalidInput")
        assert f"from {low:g} to {high:g}, the box of its prior" in content["error"]["message"]
    assert evaluate(served_models(study, local(beam), outside=True), "interface", 1.01 * high, 0.0)[0] == 200


def test_a_study_whose_model_fails_is_not_served(study: Study) -> None:
    def failing(inputs: Mapping[str, float]) -> RunRecord:
        return RunRecord("", inputs, "failed", failure_kind="singular", message="no pivot")

    with pytest.raises(InvalidStudy, match="medians of the priors failed: got singular: no pivot"):
        served_models(study, failing)


def test_noise_of_the_observation_is_part_of_the_likelihood(tmp_path: Path) -> None:
    seen = {"synthetic": {"E": 400, "tilt": 0.02, "load": 1e-5}, "noise": {"sd": 0.001, "seed": 3}}
    models = served_models(load_study(write_study(tmp_path, observation=seen)), local(beam))
    status, content = evaluate(models, "log_likelihood", 400.0, 0.02)
    expected = np.sum((0.001 * np.random.default_rng([3]).standard_normal((17, 2))) ** 2) / 0.003**2 / -2
    assert status == 200
    np.testing.assert_allclose(content["output"], [[expected]], rtol=1e-9)


@dataclass(frozen=True)
class Sheet:
    """A square whose right side is at the height E."""

    sensitivities: bool = False
    fingerprint: ClassVar[str] = "test:sheet"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        lifted = np.array([0.0, 1.0, 1.0, 0.0])
        points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
        points[:, 2] = inputs["E"] * lifted
        slope = np.zeros_like(points)
        slope[:, 2] = lifted
        sheet = Interface(points, np.array([[0, 1, 2], [0, 2, 3]]))
        return Simulation.of(sheet, {}, {"E": slope} if self.sensitivities else None)


sheet = Sheet()


def test_a_surface_has_its_triangles_as_a_block_that_does_not_move(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "sheet_of_tests", sys.modules[__name__])
    changes: dict[str, Any] = {
        "model": {"python": {"function": "sheet_of_tests:sheet"}},
        "inputs": {"E": {"prior": {"uniform": [1, 3]}}},
        "observation": {"synthetic": {"E": 2}},
    }
    study = load_study(write_study(tmp_path, fixed=None, **changes))
    models = served_models(study, local(Sheet()), local(Sheet(sensitivities=True)))
    assert models[0].output_sizes == (12, 6)
    assert evaluate(models, "interface", 2.0)[1]["output"][1] == [0, 1, 2, 0, 2, 3]
    assert models[0].apply_jacobian is not None
    assert models[0].gradient is not None
    assert models[0].apply_jacobian(0, 0, [[2.0]], [3.0])[2::3] == [0, 3, 3, 0]
    assert models[0].apply_jacobian(1, 0, [[2.0]], [3.0]) == [0.0] * 6
    assert models[0].gradient(1, 0, [[2.0]], [1.0] * 6) == [0.0]


def test_what_has_sensitivities_can_be_asked_for_them() -> None:
    assert differentiating(Cantilever()) is None
    asked: Any = differentiating(TwoLoads())
    assert asked.sensitivities is True
