"""What `strandline serve` answers for a study: interfaces, log-likelihoods, slopes and mistakes."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from strandline.foundations import InvalidStudy
from strandline.interface import Interface
from strandline.models.protocol import Simulation
from strandline.models.umbridge.answers import answer
from strandline.runs import RunRecord, RunRequest, attempt
from strandline.studies import load_study
from strandline.studies.foresight.serve import served_models
from strandline.studies.load.models import differentiating
from strandline.testing.models import Cantilever, TwoLoads
from strandline.testing.studies import beam, write_study


def local(model):
    return lambda inputs: attempt(model, RunRequest("", dict(inputs)), Path())


def evaluate(models, name, *values):
    body = f'{{"name": "{name}", "input": [{list(values)}]}}'.encode()
    given = answer(models, "POST", "/Evaluate", body)
    return given.status, given.content


def test_inputs_outside_the_boxes_are_refused_unless_asked_for(tmp_path):
    """What the model does with them is its own error."""
    study = load_study(write_study(tmp_path))
    low, high = study.space["E"].interval
    models = served_models(study, local(beam))
    assert [evaluate(models, "interface", inside, 0.0)[0] for inside in (low, high)] == [200, 200]
    for name in ("interface", "log_likelihood"):
        status, content = evaluate(models, name, 1.01 * high, 0.0)
        assert (status, content["error"]["type"]) == (400, "InvalidInput")
        assert f"from {low:g} to {high:g}, the box of its prior" in content["error"]["message"]
    anywhere = served_models(study, local(beam), outside=True)
    assert evaluate(anywhere, "interface", 1.01 * high, 0.0)[0] == 200
    with pytest.raises(ValueError, match="longer"):
        anywhere[0].evaluate([[400.0, 0.0, 1.0]])
    status, content = evaluate(anywhere, "interface", 0.001, 0.0)
    assert (status, content["error"]["type"]) == (500, "ModelError")
    assert content["error"]["message"].startswith("large_deflection: the tip would move by")
    # A study whose model fails at the medians is not served.
    with pytest.raises(InvalidStudy, match=r"medians of the priors failed: got singular at .*no pivot"):
        served_models(study, lambda inputs: RunRecord("", inputs, "failed", {}, {}, 0.0, "singular", "no pivot"))


def test_noise_of_the_observation_is_part_of_the_likelihood(tmp_path):
    seen = {"synthetic": {"E": 400, "tilt": 0.02, "load": 1e-5}, "noise": {"sd": 0.001, "seed": 3}}
    models = served_models(load_study(write_study(tmp_path, observation=seen)), local(beam))
    _, content = evaluate(models, "log_likelihood", 400.0, 0.02)
    expected = np.sum((0.001 * np.random.default_rng([3]).standard_normal((17, 2))) ** 2) / 0.003**2 / -2
    np.testing.assert_allclose(content["output"], [[expected]], rtol=1e-9)


def test_points_observed_from_the_other_end_are_the_same_observation(tmp_path):
    points = beam({"E": 400.0, "tilt": 0.02, "load": 1e-5}, tmp_path).interface.points
    found = []
    for end in (1, -1):
        np.savetxt(tmp_path / "observed.csv", points[::end], delimiter=",", header="x,y", comments="")
        observation = {"file": "observed.csv", "unit": "mm"}
        models = served_models(load_study(write_study(tmp_path, observation=observation)), local(beam))
        found.append(evaluate(models, "log_likelihood", 390.0, 0.02)[1]["output"])
    assert found[0] == found[1] != [[0.0]]


@dataclass(frozen=True)
class Sheet:
    """A square whose right side is at the height E."""

    sensitivities: bool = False
    fingerprint: ClassVar[str] = "test:sheet"

    def __call__(self, inputs, workdir):
        height = inputs["E"]
        points = np.array([[0, 0, 0], [1, 0, height], [1, 1, height], [0, 1, 0]], float)
        slope = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 1], [0, 0, 0]], float)
        sheet = Interface(points, np.array([[0, 1, 2], [0, 2, 3]]))
        return Simulation.of(sheet, {}, {"E": slope} if self.sensitivities else None)


sheet = Sheet()


def test_triangles_are_a_block_that_does_not_move(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "sheet_of_tests", sys.modules[__name__])
    model, inputs = {"python": {"function": "sheet_of_tests:sheet"}}, {"E": {"prior": {"uniform": [1, 3]}}}
    observation = {"synthetic": {"E": 2}}
    study = load_study(write_study(tmp_path, fixed=None, model=model, inputs=inputs, observation=observation))
    models = served_models(study, local(Sheet()), local(Sheet(sensitivities=True)))
    assert models[0].output_sizes == (12, 6)
    assert evaluate(models, "interface", 2.0)[1]["output"][1] == [0, 1, 2, 0, 2, 3]
    assert models[0].apply_jacobian(0, 0, [[2.0]], [3.0])[2::3] == [0, 3, 3, 0]
    assert models[0].apply_jacobian(1, 0, [[2.0]], [3.0]) == [0.0] * 6
    assert models[0].gradient(1, 0, [[2.0]], [1.0] * 6) == [0.0]
    assert differentiating(Cantilever()) is None
    assert differentiating(TwoLoads()).sensitivities is True
