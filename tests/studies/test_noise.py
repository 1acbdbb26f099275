"""Noise of the observed points in a study file: what it becomes, and a study from its file to its posterior."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.studies.test_run_study import rerun

from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import GaussianNoise, PointErrors, UnknownErrors, spacings
from strandline.studies import load_study
from strandline.studies.noise import require_stated
from strandline.testing.studies import TWO_LOADS_STUDY, two_loads, write_study

STATED = {"sd": 3, "length": 15, "unit": "um"}


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"sd": 3, "unit": "um"}, PointErrors(0.003)),
        (STATED, PointErrors(0.003, 0.015)),
        ({"sd": 0.003, "length": 0.015, "unit": "mm"}, PointErrors(0.003, 0.015)),
        (
            {**STATED, "unknown": {"shift": 8, "rotation": 0.5, "scale": 0.005, "offset": 2, "shared": True}},
            PointErrors(0.003, 0.015, 0.008, 0.5, 0.005, 0.002, True),
        ),
        ({"sd": 0.5}, GaussianNoise(0.25)),
        ({"variance": 0.5}, GaussianNoise(0.5)),
    ],
)
def test_lengths_become_mm(tmp_path: Path, given: dict[str, Any], expected: Any) -> None:
    noise = load_study(write_study(tmp_path, noise=given)).noise
    assert type(noise) is type(expected)
    for name, value in vars(expected).items():
        assert getattr(noise, name) == pytest.approx(value)


@pytest.mark.usefixtures("without_report")
@pytest.mark.parametrize("measure", ["normal_offset", "closest_point"])
def test_a_study_with_noise_of_the_points(tmp_path: Path, measure: str) -> None:
    outcome = rerun(tmp_path / "beam", discrepancy={measure: {}}, noise=STATED)
    (condition,) = outcome.summary["likelihood"]["conditions"]
    assert condition["point_sd"] == pytest.approx(0.003)
    assert condition["correlation_length"] == pytest.approx(0.015)
    assert (condition["noise_variance"] == 1.0) == (measure == "normal_offset")
    estimate = outcome.summary["inputs"]["E"]
    assert abs(estimate["mean"] - 400.0) < 3 * estimate["sd"]


@pytest.mark.usefixtures("without_report")
def test_wider_noise_gives_a_wider_posterior(tmp_path: Path) -> None:
    def sd(name: str, **noise: Any) -> float:
        """Return the sd of a well-known input: of one that fills its prior, it says little."""
        changes = {"discrepancy": {"normal_offset": {}}, "surrogate": {"field": {}}}
        done = rerun(tmp_path / name, noise={**STATED, **noise}, **changes)
        return float(done.summary["inputs"]["E"]["sd"])

    assert 1.5 * sd("narrow", sd=0.3) < sd("wide", sd=0.6) < 0.8 * sd("unknown", sd=0.6, unknown={"offset": 3})


EDGE = "x,y,sd\n" + "".join(f"{0.0625 * k},{0.12 * (k / 16) ** 2},{0.001 * (1 + k % 3)}\n" for k in range(17))


def of_a_table(folder: Path, noise: dict[str, Any], **options: Any) -> Any:
    folder.mkdir(exist_ok=True)
    (folder / "edge.csv").write_text(EDGE)
    return write_study(folder, observation={"file": "edge.csv", "unit": "mm", **options}, noise=noise)


COLUMN = {"sd": "column", "length": 20, "unit": "um"}


def test_each_point_has_the_sd_of_its_column(tmp_path: Path) -> None:
    options = {"columns": ["x", "y"], "sd": "sd", "hide": {"x": [0.3, 0.4]}}
    study = load_study(of_a_table(tmp_path, {**COLUMN, "unknown": {"offset": 2}}, **options))
    seen = study.observed[""]
    errors = study.noise_of("")
    assert isinstance(errors, PointErrors)
    expected = np.array([0.001 * (1 + k % 3) for k in range(17) if not 0.3 <= 0.0625 * k <= 0.4])
    np.testing.assert_allclose(errors.sds(seen), expected)
    assert (errors.length, errors.offset) == pytest.approx((0.02, 0.002))
    apart = spacings(seen, gaps=False)
    np.testing.assert_allclose(errors.model(seen).local, expected**2 / np.tanh(apart / 0.04), rtol=1e-9)


@pytest.mark.parametrize(
    ("noise", "options", "said"),
    [
        (COLUMN, {"columns": [1, 2]}, "observation: {file: …, sd: COLUMN}"),
        (STATED, {"columns": [1, 2], "sd": "sd"}, "the noise does not take it"),
        (COLUMN, {"columns": [1, 2], "sd": "s"}, "no column s"),
        (COLUMN, {"columns": [1, 2], "sd": 0}, "a column, by name or by number"),
        (COLUMN, {"columns": [1, 2], "sd": "x"}, "standard deviation of point 1"),
        ({**COLUMN, "length": "unknown"}, {"sd": "sd"}, "State the length, or write `sd: unknown`."),
        ({**COLUMN, "model_error": True}, {"sd": "sd"}, "Remove model_error and spread."),
        ({"sd": "column"}, {"sd": "sd"}, "`unit`"),
    ],
)
def test_columns_that_cannot_be_used_are_refused(
    tmp_path: Path, noise: dict[str, Any], options: dict[str, Any], said: str
) -> None:
    with pytest.raises(InvalidInput) as caught:
        load_study(of_a_table(tmp_path, noise, **options))
    assert said in str(caught.value)


def of_two_loads(folder: Path, observation: dict[str, Any], noise: dict[str, Any], **changes: Any) -> Any:
    """Write a study of two loads, with the sd of each point in the third column of its files."""
    files = [{"condition": name, "file": f"{name}.csv", "unit": "um", **keys} for name, keys in observation.items()]
    write_study(folder, **{**TWO_LOADS_STUDY, "observation": files, "noise": noise, **changes})
    for name, interface in two_loads({"E": 400.0, "load": 1e-5}, folder).interfaces.items():
        points = interface.points * 1000
        np.savetxt(folder / f"{name}.csv", np.column_stack([points, np.full(len(points), 3.0)]), delimiter=",")
    return folder


def test_a_condition_of_its_own_noise_has_no_column(tmp_path: Path) -> None:
    with_sd, without = {"columns": [1, 2], "sd": 3}, {"columns": [1, 2]}
    for first in ({"light": without, "heavy": with_sd}, {"heavy": with_sd, "light": without}):
        study = load_study(of_two_loads(tmp_path, first, {**COLUMN, "conditions": {"light": STATED}}))
        assert study.noise_of("light") == PointErrors(0.003, 0.015)
        heavy = study.noise_of("heavy")
        assert isinstance(heavy, PointErrors)
        np.testing.assert_allclose(heavy.sds(study.observed["heavy"]), 0.003)


SHARED = {**STATED, "unknown": {"shift": 8, "rotation": 0.5, "shared": True}}
OWN = {**STATED, "unknown": {"shift": 8, "rotation": 0.5}}
OTHER = {**STATED, "unknown": {"shift": 9, "rotation": 0.5, "shared": True}}


@pytest.mark.parametrize(
    ("noise", "said"),
    [
        ({**OWN, "conditions": {"light": SHARED}}, "condition light: got condition heavy with its own errors"),
        ({**SHARED, "conditions": {"light": {"variance": 1}}}, "got condition light with its own errors"),
        ({**SHARED, "conditions": {"light": OTHER}}, "got condition heavy with another shift, rotation or scale"),
    ],
)
def test_errors_that_only_some_conditions_share_are_refused(tmp_path: Path, noise: dict[str, Any], said: str) -> None:
    with pytest.raises(InvalidStudy, match=said):
        load_study(write_study(tmp_path, **{**TWO_LOADS_STUDY, "noise": noise}))


def test_conditions_may_share_errors_and_have_their_own_sd_and_offset(tmp_path: Path) -> None:
    own = {**SHARED, "sd": 5, "unknown": {**SHARED["unknown"], "offset": 2}}
    noise = {**SHARED, "conditions": {"light": own}}
    study = load_study(write_study(tmp_path, **{**TWO_LOADS_STUDY, "noise": noise}))
    assert study.noise_of("light") == PointErrors(0.005, 0.015, 0.008, 0.5, offset=0.002, shared=True)


BY_FIELD = {"discrepancy": {"normal_offset": {}}, "surrogate": {"field": {}}}


@pytest.mark.parametrize(
    ("noise", "changes", "said"),
    [
        (
            {**STATED, "conditions": {"light": {"sd": "unknown", "unit": "um"}}},
            BY_FIELD,
            "State the same unknown sd, length or model_error for every condition, or for none.",
        ),
        ({**SHARED, "model_error": True}, BY_FIELD, "expected a known sd and length, no model_error and no spread"),
    ],
)
def test_the_remedy_is_the_right_one(tmp_path: Path, noise: dict[str, Any], changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InvalidInput) as caught:
        load_study(write_study(tmp_path, **{**TWO_LOADS_STUDY, "noise": noise, **changes}))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("noise", "value"),
    [(UnknownErrors(), "unknown"), (UnknownErrors(0.003, 0.015, model_error=True), "a model error")],
)
def test_commands_that_need_a_known_noise_say_so(noise: UnknownErrors, value: str) -> None:
    with pytest.raises(InvalidStudy, match=f"`strandline serve` needs a known noise: got {value};"):
        require_stated([PointErrors(0.003), noise], "strandline serve")
    require_stated([PointErrors(0.003), GaussianNoise(1.0)], "strandline serve")


def test_a_synthetic_observation_has_no_column(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="a table with the standard deviation"):
        load_study(write_study(tmp_path, noise=COLUMN))


def test_a_correlation_longer_than_the_interface_is_refused_before_any_run(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="correlation length"):
        rerun(tmp_path / "beam", noise={**STATED, "length": 1e7})


@pytest.mark.parametrize(
    ("noise", "said"),
    [
        ({"sd": "unknown", "unit": "um"}, "the measure normal_offset and a surrogate of the field"),
        ({"sd": [1, 5], "unit": "um"}, "the measure normal_offset and a surrogate of the field"),
        ({**STATED, "model_error": True}, "the measure normal_offset and a surrogate of the field"),
        ({**STATED, "spread": ["tilt"]}, "several, whose inputs may differ"),
        ({**STATED, "spread": ["E", "nu"]}, "some of E, tilt"),
        ({"sd": [5, 1], "unit": "um"}, "0 < low < high"),
        ({"sd": 3, "length": [0, 1], "unit": "um"}, "0 < low < high"),
    ],
)
def test_unknown_noise_that_nothing_can_infer_is_refused(tmp_path: Path, noise: dict[str, Any], said: str) -> None:
    with pytest.raises(InvalidInput, match=said):
        load_study(write_study(tmp_path, noise=noise))


@pytest.mark.usefixtures("without_report")
def test_a_study_with_unknown_noise(tmp_path: Path) -> None:
    outcome = rerun(
        tmp_path / "beam",
        observation={"synthetic": {"E": 400, "tilt": 0.02, "load": 1e-5}, "noise": {"sd": 0.003}},
        discrepancy={"normal_offset": {}},
        noise={"sd": [1, 9], "length": "unknown", "unit": "um", "model_error": True},
        surrogate={"field": {}},
    )
    found = outcome.summary["likelihood"]["inferred_noise"]
    assert 1.0 < found["sd_um"]["median"] < 9.0
    assert found["sd_um"]["q05"] < found["sd_um"]["median"] < found["sd_um"]["q95"]
    assert 0 <= found["model_error"]["probability"] <= 1
    assert found["prior"] == {"sd_um": [1.0, 9.0], "length_um": None}
    for name in ("amplitude_quantiles_um", "length_um"):
        assert 0 < found["model_error"][name]["q05"] <= found["model_error"][name]["q95"]
    whole = 1e3 * float(outcome.calibration.problem.observations[0].interface.lengths.sum())
    assert 0.05 * whole <= found["model_error"]["length_um"]["median"] * 1.0001 <= 0.5001 * whole
    without, with_it = found["without_model_error"]["E"], outcome.summary["inputs"]["E"]
    assert 0 < without["sd"] < 1.3 * with_it["sd"]
    assert abs(without["mean"] - 400.0) < 4 * without["sd"]


@pytest.mark.usefixtures("without_report")
def test_the_first_condition_has_its_own_noise_in_the_summary(tmp_path: Path) -> None:
    noise = {"sd": 30, "unit": "um", "conditions": {"light": {"sd": 10, "length": 15, "unit": "um"}}}
    changes = {**TWO_LOADS_STUDY, "discrepancy": {"closest_point": {}}, "noise": noise}
    found = rerun(tmp_path / "study", **changes).summary["likelihood"]
    light, heavy = found["conditions"]
    assert (light["condition"], heavy["condition"]) == ("light", "heavy")
    assert (light["point_sd"], heavy["point_sd"]) == pytest.approx((0.01, 0.03))
    for key in ("point_sd", "correlation_length", "noise_variance"):
        assert found[key] == light[key]


KEYS = Path("docs/reference/summary.md").read_text("utf-8")


@pytest.mark.usefixtures("without_report")
def test_the_keys_of_noise_in_the_summary_are_described(tmp_path: Path) -> None:
    everything = {**STATED, "unknown": {"shift": 8, "rotation": 0.5, "scale": 0.005, "offset": 2}}
    stated = rerun(tmp_path / "stated", discrepancy={"normal_offset": {}}, noise=everything).summary["likelihood"]
    others = {"discrepancy", "options", "unit", "conditions", "independent_terms", "gaussian_constant"}
    for key in stated.keys() - others:
        assert f"`likelihood.{key}`" in KEYS
