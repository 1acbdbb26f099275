"""A study with a nuisance input, from study.yaml to its results, against sums over the model's closed form."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp

from strandline.cli import main
from strandline.errors import InvalidStudy
from strandline.posterior import cut_from_datatree, from_datatree, read
from strandline.report.warnings import find_warnings
from strandline.runs import InProcess
from strandline.studies import Outcome, load_study, run_study
from strandline.testing.studies import BEAM_STUDY, write_study

NOISE = 0.004
INPUTS: dict[str, Any] = {
    "tilt": {"prior": {"beta": [2.0, 4.0, 0.0, 0.04]}, "nuisance": True},
    "E": {"prior": {"uniform": [300, 560]}, "unit": "Pa"},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("uncertain")
    return write_study(home / "beam", inputs=INPUTS, noise={"sd": NOISE}, design={"sobol": {"runs": 100}})


@pytest.fixture(scope="module")
def outcome(folder: Path) -> Outcome:
    return run_study(load_study(folder), executor=InProcess())


def exact() -> dict[str, tuple[float, float]]:
    """Return mean and standard deviation of E in both readings by a fine sum."""
    E, tilt = np.linspace(300.0, 560.0, 1501), np.linspace(0.0, 0.04, 802)[1:-1]
    x = np.linspace(0.0, 1.0, 17)
    shape, slope = x**2 * (3 - x), x
    a, b = 20.0 / E - 0.05, tilt - 0.02
    squares = (
        (a**2 * (shape @ shape))[:, None] + 2 * np.outer(a, b) * (shape @ slope) + (b**2 * (slope @ slope))[None, :]
    )
    log_likelihood, s = -0.5 * squares / NOISE**2, tilt / 0.04
    log_prior = np.log(s) + 3 * np.log1p(-s)
    log_prior -= logsumexp(log_prior)
    joint = np.exp(log_likelihood + log_prior - logsumexp(log_likelihood + log_prior)).sum(axis=1)
    cut = np.exp(log_likelihood - logsumexp(log_likelihood, axis=0)) @ np.exp(log_prior)
    return {name: _moments(E, density) for name, density in {"joint": joint, "cut": cut}.items()}


def _moments(x: Any, weights: Any) -> tuple[float, float]:
    mean = float(weights @ x)
    return mean, float(np.sqrt(weights @ (x - mean) ** 2))


def test_both_readings_are_exact_and_differ(outcome: Outcome) -> None:
    expected = exact()
    for name, (mean, sd) in expected.items():
        found = outcome.summary["under_uncertainty"][name]["inputs"]["E"]
        assert abs(found["mean"] - mean) < 0.1 * sd
        assert found["sd"] == pytest.approx(sd, rel=0.06)
        assert abs(found["map"] - mean) < 2 * sd
    (joint, joint_sd), (cut, cut_sd) = expected["joint"], expected["cut"]
    assert abs(joint - cut) > 0.2 * min(joint_sd, cut_sd) or abs(joint_sd / cut_sd - 1) > 0.12, "exchanged: unseen"


def test_the_summary_agrees_with_itself(outcome: Outcome) -> None:
    summary, found = outcome.summary, outcome.calibration.under_uncertainty
    assert found is not None
    both = summary["under_uncertainty"]
    assert [item["nuisance"] for item in summary["inputs"].values()] == [True, False]
    assert both["joint"]["inputs"].keys() == both["cut"]["inputs"].keys() == {"E"}
    assert both["joint"]["inputs"]["E"]["mean"] == pytest.approx(summary["inputs"]["E"]["mean"])
    assert both["joint"]["map_bins"] == both["cut"]["map_bins"] == 30
    assert both["cut"]["covariance"] == [[pytest.approx(both["cut"]["inputs"]["E"]["sd"] ** 2)]]
    assert len(both["cut"]["nuisance_values"]["tilt"]) == len(both["cut"]["log_evidence"]) == 32
    assert both["cut"]["joint_log_evidence"] == pytest.approx(summary["log_evidence"], abs=0.15)
    assert both["cut"]["particles"] == 32 * 250
    assert len(summary["laplace"]["eigenvalues"]) == 2
    assert list(summary["seconds"]) == ["forward", "surrogate", "sampling", "cut", "check", "report"]
    assert json.loads(outcome.report.with_name("summary.json").read_text())["under_uncertainty"] == both


def test_the_quadrature_checks_the_cut(outcome: Outcome) -> None:
    check = outcome.summary["under_uncertainty"]["cut"]["quadrature_check"]
    assert check["converged"]
    assert check["max_mean_error_sd"] < 0.06
    assert check["max_sd_ratio_error"] < 0.05
    assert check["E"]["mean"] == pytest.approx(exact()["cut"][0], rel=0.005)
    parts, found = outcome.calibration.cut_quadrature, outcome.calibration.under_uncertainty
    assert parts is not None
    assert found is not None
    errors = found.cut.log_evidence - [part.log_evidence for part in parts]
    assert np.sqrt(np.mean(errors**2)) < 0.4


def test_both_readings_are_in_the_file(folder: Path, outcome: Outcome) -> None:
    tree, study = read(folder / "posterior.nc"), load_study(folder)
    cut, found = cut_from_datatree(tree, study.space), outcome.calibration.under_uncertainty
    assert cut is not None
    assert found is not None
    np.testing.assert_array_equal(cut.extended.draws, found.cut.extended.draws)
    np.testing.assert_array_equal(cut.value_index, found.cut.value_index)
    np.testing.assert_array_equal(from_datatree(tree, study.space).draws, found.joint.extended.draws)


def test_the_report_shows_both(folder: Path, outcome: Outcome) -> None:
    page = outcome.report.read_text()
    assert '<h2 id="uncertainty">' in page
    assert "Which values of E explain" in page
    assert "with tilt uncertain" in " ".join(page.split())
    for name in ("cut_marginals", "nuisance"):
        assert f'id="{name}"' in page
        assert (folder / "figures" / f"{name}.png").is_file()
    for reading in ("joint", "cut"):
        assert f"{outcome.summary['under_uncertainty'][reading]['inputs']['E']['mean']:.4g}" in page


def test_without_nuisance_inputs_there_is_no_such_thing(finished: Any) -> None:
    assert finished.outcome.calibration.under_uncertainty is None
    assert finished.outcome.calibration.cut_quadrature is None
    assert finished.outcome.summary["under_uncertainty"] is None
    assert 'id="uncertainty"' not in (finished.folder / "report.html").read_text()
    assert cut_from_datatree(read(finished.folder / "posterior.nc"), finished.study.space) is None


def test_a_rough_surrogate_of_the_cut_is_told(outcome: Outcome) -> None:
    calibration = outcome.calibration
    assert not any("cut reading" in warning for warning in find_warnings(calibration))
    surrogate = calibration.surrogate
    validation = replace(surrogate.validation, residuals=surrogate.validation.residuals + 3.0)
    rough = replace(calibration, surrogates={"tracked_points": replace(surrogate, validation=validation)})
    assert any("less certain than the joint one" in warning for warning in find_warnings(rough))
    parts = calibration.cut_quadrature
    assert parts is not None
    moved = replace(calibration, cut_quadrature=tuple(replace(part, mean=part.mean + 10.0) for part in parts))
    assert any("quadrature of the cut reading differ" in warning for warning in find_warnings(moved))


def test_a_cut_reading_at_a_bound_is_told(outcome: Outcome) -> None:
    calibration = outcome.calibration
    found = calibration.under_uncertainty
    assert found is not None
    draws = found.cut.extended.draws.copy()
    draws[found.cut.value_index == 0, 1] = 301.0
    cut = replace(found.cut, extended=replace(found.cut.extended, draws=draws))
    told = list(find_warnings(replace(calibration, under_uncertainty=replace(found, cut=cut))))
    before = list(find_warnings(calibration))
    expected = "The cut reading of E reaches the lower end of its box, 300 Pa"
    assert any(warning.startswith(expected) for warning in told)
    assert not any(warning.startswith((expected, "The cut reading of tilt")) for warning in before)


def refused(tmp_path: Path, **changes: Any) -> InvalidStudy:
    with pytest.raises(InvalidStudy) as caught:
        load_study(write_study(tmp_path / "study", **changes))
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.mark.parametrize("value", [3, "yes", 1, None])
def test_nuisance_is_true_or_false(tmp_path: Path, value: Any) -> None:
    inputs = {**INPUTS, "tilt": {**INPUTS["tilt"], "nuisance": value}}
    error = refused(tmp_path, inputs=inputs)
    assert "inputs.tilt.nuisance" in str(error)
    assert "true or false" in error.expected


def test_one_input_must_be_calibrated(tmp_path: Path) -> None:
    inputs = {name: {**item, "nuisance": True} for name, item in INPUTS.items()}
    error = refused(tmp_path, inputs=inputs)
    assert "inputs to calibrate: got none: tilt, E are all nuisance; expected at least one" in str(error)


@pytest.mark.parametrize("values", [1, 2.5, True, "many"])
def test_bad_numbers_of_values(tmp_path: Path, values: Any) -> None:
    error = refused(tmp_path, inputs=INPUTS, sampler={"cut": {"values": values}})
    assert "sampler.cut.values" in str(error)


def test_the_number_of_values_arrives(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, inputs=INPUTS, sampler={"cut": {"values": 8}}))
    assert study.settings.nuisance_values == 8
    assert [p.nuisance for p in study.space] == [True, False]
    assert load_study(write_study(tmp_path, **BEAM_STUDY)).settings.nuisance_values == 32


def test_check_tells_which_inputs_are_nuisance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["check", str(write_study(tmp_path / "study", inputs=INPUTS))])
    lines = {line.split()[0].rstrip(":"): line for line in capsys.readouterr().out.splitlines() if line[:2] == "  "}
    assert lines["tilt"].endswith(", nuisance")
    assert "nuisance" not in lines["E"]
