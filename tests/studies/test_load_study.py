"""From the content of study.yaml to objects of the domain."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.discrepancy import ClosestPoint, Currents, MeasurementLines, TrackedPoints
from strandline.errors import InvalidStudy
from strandline.interface import GaussianNoise
from strandline.models.python import PythonModel
from strandline.priors import LogNormal, Normal, ScaledBeta, Uniform
from strandline.runs import LocalProcesses
from strandline.smc import SMCSettings
from strandline.studies import load_study
from strandline.testing.studies import BEAM_STUDY, write_study

BIOFILM: dict[str, Any] = {
    "model": {"biofilm": {"mesh": "coarse"}},
    "fixed": {"V_in": 100},
    "inputs": {
        "E": {"prior": {"uniform": [100, 800]}, "unit": "Pa"},
        "nu": {"prior": {"uniform": [-0.8, 0.5]}},
    },
    "observation": {"synthetic": {"E": 400, "nu": 0.3, "V_in": 100}},
}


def one_input(**item: Any) -> dict[str, Any]:
    return {**BEAM_STUDY["inputs"], "E": item}


def refused(tmp_path: Path, **changes: Any) -> InvalidStudy:
    with pytest.raises(InvalidStudy) as caught:
        load_study(write_study(tmp_path / "study", **changes))
    assert "\n" not in str(caught.value)
    return caught.value


def test_everything_arrives(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    folder = write_study(
        tmp_path / "study",
        name="all",
        discrepancy=[{"currents": {"width": 0.01, "quadrature": "centre"}}, {"closest_point": None}],
        noise={"variance": 0.25},
        design={"sobol": {"runs": 33, "scramble": 7}},
        surrogate={"log_likelihood": {"kernel": "matern32"}},
        sampler={"smc": {"particles": 50, "rejuvenation_steps": 3, "zeta": 0.9}},
        executor={"local": {"workers": 3, "timeout": 5}},
        reuse=["../other"],
        seed=11,
    )
    study = load_study(folder)
    assert (study.name, study.folder, study.noise) == ("all", folder, GaussianNoise(0.25))
    assert study.model == PythonModel("strandline.testing.studies:beam")
    assert study.fixed == {"load": 1e-5}
    assert [(p.name, p.prior, p.unit) for p in study.space] == [
        ("E", Uniform(300.0, 560.0), "Pa"),
        ("tilt", Uniform(0.0, 0.04), "1"),
    ]
    assert study.discrepancies == {"currents": Currents(0.01, quadrature="centre"), "closest_point": ClosestPoint()}
    assert list(study.discrepancies) == ["currents", "closest_point"]
    settings = study.settings
    assert (settings.runs, settings.scramble, settings.kernel, settings.particles) == (33, 7, "matern32", 50)
    assert settings.smc == SMCSettings(rejuvenation_steps=3, zeta=0.9)
    assert settings.seed == 11
    assert study.executor == LocalProcesses(workers=3, timeout=5.0)
    assert [path.resolve() for path in study.reuse] == [tmp_path / "other" / "ledger.sqlite"]
    assert study.truth == {"E": 400.0, "tilt": 0.02, "load": 1e-5}
    assert sorted(path.name for path in folder.iterdir()) == ["study.yaml"]


def test_noise_as_standard_deviation(tmp_path: Path) -> None:
    assert load_study(write_study(tmp_path, noise={"sd": 0.5})).noise == GaussianNoise(0.25)


@pytest.mark.parametrize(
    ("prior", "expected"),
    [
        ({"uniform": [310, 500]}, Uniform(310.0, 500.0)),
        ({"normal": [400, 30]}, Normal(400.0, 30.0)),
        ({"lognormal": [6, 0.1]}, LogNormal(6.0, 0.1)),
        ({"beta": [2, 3, 310, 500]}, ScaledBeta(2.0, 3.0, 310.0, 500.0)),
    ],
)
def test_priors(tmp_path: Path, prior: dict[str, Any], expected: Any) -> None:
    study = load_study(write_study(tmp_path, inputs=one_input(prior=prior, unit="Pa", box=[300, 560])))
    assert study.space["E"].prior == expected
    assert study.space["E"].interval == (300.0, 560.0)


@pytest.mark.parametrize("unit", ["mm^2/s", "mm²/s", "mm**2 / s"])
def test_spellings_of_a_unit(tmp_path: Path, unit: str) -> None:
    study = load_study(write_study(tmp_path, **BIOFILM | {"fixed": {"V_in": {"value": 90, "unit": unit}}}))
    assert study.fixed == {"V_in": 90.0}


def test_an_observed_file_is_read_in_its_unit_and_turned_round(tmp_path: Path) -> None:
    from strandline.models.biofilm.outline import Outline

    points = Outline().interface().points[::-1] * 1000
    np.savetxt(tmp_path / "o.csv", points, delimiter=",")
    study = load_study(write_study(tmp_path, **BIOFILM | {"observation": {"file": "o.csv", "unit": "um"}}))
    assert list(study.observed) == [""]
    np.testing.assert_allclose(study.observed[""].points, Outline().interface().points, atol=1e-12)
    assert study.turned == ("",)
    assert study.truth is None
    np.savetxt(tmp_path / "o.csv", points[::-1], delimiter=",")
    assert load_study(tmp_path).turned == ()


def test_an_observed_file_with_decimal_commas(tmp_path: Path) -> None:
    from strandline.models.biofilm.outline import Outline

    points = Outline().interface().points
    (tmp_path / "o.csv").write_text("x;y\n" + "\n".join(f"{x!r};{y!r}".replace(".", ",") for x, y in points.tolist()))
    observation = {"file": "o.csv", "unit": "mm", "columns": ["x", "y"]}
    with pytest.raises(
        InvalidStudy, match=r"semicolons and commas in line 2: .* With decimal commas give `decimal: \",\"`"
    ):
        load_study(write_study(tmp_path, **BIOFILM | {"observation": observation}))
    study = load_study(write_study(tmp_path, **BIOFILM | {"observation": observation | {"decimal": ","}}))
    np.testing.assert_array_equal(study.observed[""].points, points)


def test_an_observed_file_in_the_wrong_unit(tmp_path: Path) -> None:
    from strandline.models.biofilm.outline import Outline

    np.savetxt(tmp_path / "o.csv", Outline().interface().points * 1000, delimiter=",")
    with pytest.raises(
        InvalidStudy, match=r"read in mm: got .* mm across, .* times the model.s interface; expected about"
    ):
        load_study(write_study(tmp_path, **BIOFILM | {"observation": {"file": "o.csv", "unit": "mm"}}))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"model": {"biofilmm": {}}},
            ["model: got biofilmm", "biofilm, command, python, umbridge", "Did you mean biofilm?"],
        ),
        ({"model": {"biofilm": {"mush": 1}}}, ["model.biofilm: unknown option: got mush", "Did you mean mesh?"]),
        ({"model": {"biofilm": {"mesh": "huge"}}}, ["model.biofilm: mesh", "got huge", "coarse, default, fine"]),
        ({"model": {"python": {}}}, ["model.python.function: got nothing", "Add `function: …`"]),
        ({"model": {"python": {"function": "nowhere:f"}}}, ["got nowhere:f", "PYTHONPATH"]),
        ({"model": {"python": {"function": 3}}}, ["model.python.function: got 3", "a text"]),
        ({"model": {"python": {"function": "beam"}}}, ["got beam", "module:name"]),
        ({"model": {"python": {"function": "strandline.testing.studies:bean"}}}, ["a callable bean"]),
        ({"discrepancy": {"curents": {}}}, ["discrepancy: got curents", "Did you mean currents?"]),
        ({"discrepancy": {"currents": {}}}, ["discrepancy.currents.width: got nothing"]),
        ({"discrepancy": {"currents": {"width": -1.0}}}, ["discrepancy.currents", "got -1", "above 0"]),
        ({"discrepancy": {"currents": {"width": "wide"}}}, ["discrepancy.currents.width: got wide; expected a number"]),
        ({"discrepancy": {"currents": {"width": True}}}, ["discrepancy.currents.width: got True"]),
        ({"discrepancy": {"tracked_points": {"lines": 3}}}, ["unknown option: got lines; expected no options"]),
        ({"discrepancy": {"measurement_lines": {"reach": 0}}}, ["reach of the measurement lines: got 0.0"]),
        ({"discrepancy": [{"closest_point": {}}, {"closest_point": {}}]}, ["each measure once"]),
        ({"surrogate": {"log_likelihood": {"kernel": "mattern32"}}}, ["got mattern32", "Did you mean matern32?"]),
        ({"design": {"sobol": {"runs": 3}}}, ["design.sobol.runs: got 3", "at least 4 runs for 2 input(s)"]),
        ({"reuse": ["../nothing"]}, ["reuse: got ../nothing", "folder of another study"]),
        ({"fixed": {"load": 1, "lode": 2}}, ["fixed.lode: the model has no such input", "Did you mean load?"]),
        ({"fixed": {"load": 1, "E": 400}}, ["E is both fixed and an input: got 400.0"]),
        ({"fixed": {}}, ["no value for load, which the model takes", "Add e.g. `fixed: {load: …}`"]),
        ({"fixed": {"load": {"value": 1, "unit": "kN/m"}}}, ["unit of fixed.load: got kN/m; expected N/m"]),
        ({"inputs": one_input(prior={"uniform": [300, 560]})}, ["unit of inputs.E: got nothing", "unit: Pa"]),
        ({"inputs": one_input(prior={"uniform": [300, 560]}, unit="kPa")}, ["got kPa; expected Pa"]),
        ({"inputs": one_input(prior={"uniform": [-300, 560]}, unit="Pa")}, ["inputs.E", "got -300", "(0, inf] Pa"]),
        ({"inputs": one_input(prior={"uniform": [300]}, unit="Pa")}, ["inputs.E.prior.uniform", "2 numbers"]),
        ({"inputs": one_input(prior={"uniform": [560, 300]}, unit="Pa")}, ["inputs.E", "the lower one first"]),
        ({"inputs": one_input(prior={"unifrom": [1, 2]}, unit="Pa")}, ["got unifrom", "Did you mean uniform?"]),
        ({"inputs": one_input(prior={"normal": [400, 30]}, unit="Pa")}, ["inputs.E: design box", "Give E a box"]),
        (
            {"inputs": one_input(prior={"uniform": [300, 700]}, unit="Pa", box=[300, 560])},
            ["the prior of E reaches beyond its design box", "support [300, 700], box [300, 560], 35% of its mass"],
        ),
        (
            {"inputs": one_input(prior={"uniform": [600, 700]}, unit="Pa", box=[300, 560])},
            ["inputs.E: truncated prior keeps no mass", "Move the bounds or the prior."],
        ),
        (
            {"inputs": one_input(prior={"lognormal": [8, 0.3]}, unit="Pa", box=[300, 2000])},
            ["the prior of E reaches beyond its design box", "at most half"],
        ),
        (
            {"inputs": {**BEAM_STUDY["inputs"], "Tilt": {"prior": {"uniform": [0, 1]}}}},
            ["inputs.Tilt: the model has no such input", "Did you mean tilt?"],
        ),
        ({"observation": {"synthetic": {"E": 400}}}, ["observation.synthetic: got E: 400", "tilt, load too"]),
        (
            {"observation": {"synthetic": {"E": -4, "tilt": 0, "load": 0}}},
            ["observation.synthetic.E: got -4", "Young's modulus"],
        ),
        (
            {"observation": {"synthetic": {"E": 4, "tilt": 0, "load": 0, "nu": 0}}},
            ["observation.synthetic.nu: the model has no such input"],
        ),
        ({"observation": {"file": "none.csv", "unit": "mm"}}, ["observation none.csv is missing"]),
        (BIOFILM | {"fixed": {"V_in": -1}}, ["fixed.V_in: got -1.0", "inflow volume rate per depth"]),
        (
            BIOFILM | {"inputs": BIOFILM["inputs"] | {"nu": {"prior": {"uniform": [-0.8, 0.6]}}}},
            ["inputs.nu", "got 0.6", "Poisson's ratio"],
        ),
    ],
)
def test_refused(tmp_path: Path, changes: dict[str, Any], words: list[str]) -> None:
    message = str(refused(tmp_path, **changes))
    for word in words:
        assert word in message


def test_a_mild_truncation_is_accepted_and_known(tmp_path: Path) -> None:
    inputs = one_input(prior={"lognormal": [6.0, 0.2]}, unit="Pa", box=[300, 560])
    study = load_study(write_study(tmp_path, inputs=inputs))
    assert 0.0 < study.space["E"].mass_cut < 0.5


def test_a_model_that_declares_nothing_takes_the_studys_units(tmp_path: Path) -> None:
    undeclared = {"python": {"function": "strandline.testing.studies:undeclared_beam"}}
    inputs = {"E": {"prior": {"uniform": [300, 560]}}, "tilt": {"prior": {"uniform": [0, 0.04]}, "unit": "rad"}}
    study = load_study(write_study(tmp_path, model=undeclared, inputs=inputs))
    assert [p.unit for p in study.space] == ["1", "rad"]
    error = refused(tmp_path, model=undeclared, inputs=inputs, observation={"synthetic": {"E": 1, "tilt": 0}})
    assert "load too" in error.expected
    error = refused(tmp_path, model=undeclared, observation={"synthetic": {"E": 1, "tilt": 0, "load": 1, "nu": 1}})
    assert error.value == "nu"


def test_measures_by_their_options(tmp_path: Path) -> None:
    lines = [[0.5, 0.1, 0, 1]]
    folder = write_study(tmp_path, discrepancy=[{"measurement_lines": {"lines": lines}}, {"tracked_points": {}}])
    assert load_study(folder).discrepancies == {
        "measurement_lines": MeasurementLines(lines),
        "tracked_points": TrackedPoints(),
    }


def test_the_digest_is_of_the_text(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path))
    assert study.text_digest == load_study(tmp_path).text_digest
    assert replace(study, text=study.text + " ").text_digest != study.text_digest


@pytest.mark.parametrize(
    ("changes", "what", "value"),
    [
        ({"sampler": {"smc": {"zeta": 1}}}, "sampler.smc.zeta", 1.0),
        ({"sampler": {"smc": {"rejuvenation_steps": 0}}}, "sampler.smc.rejuvenation_steps", 0),
        ({"executor": {"local": {"workers": 0}}}, "executor.local.workers", 0),
        ({"executor": {"slurm_array": {"cpus": -1}}}, "executor.slurm_array.cpus", -1),
        (
            {"design": {"sobol": {"runs": 9}, "refine": {"runs": 5, "temperature": 2}}},
            "design.refine: temperature",
            2.0,
        ),
    ],
)
def test_what_a_class_refuses_is_said_with_its_place(
    tmp_path: Path, changes: dict[str, Any], what: str, value: Any
) -> None:
    error = refused(tmp_path, **changes)
    assert error.what.startswith(what)
    assert error.value == value
