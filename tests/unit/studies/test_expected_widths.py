"""Widths predicted before any campaign, against those of the study itself and against plain linear algebra."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import block_diag

from strandline.foundations import NumericsError
from strandline.interface import Interface, PointErrors
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.runs import RunRecord, RunRequest, attempt
from strandline.studies import load_study
from strandline.studies.foresight import widths
from strandline.studies.foresight.widths import (
    STEP,
    expected_sd,
    neighbours,
    predicted_at,
    slopes_by_differences,
)
from strandline.testing.studies import TWO_LOADS_STUDY, write_study

AT = np.array([400.0, 0.02])


def run(study, x, folder):
    inputs = {**study.fixed, **study.space.as_mapping(x)}
    return attempt(study.model, RunRequest("key", inputs), folder)


def run_with_slopes(study, at, folder):
    record, x = run(study, at, folder), neighbours(study.space, at)
    return record, slopes_by_differences(record, [run(study, row, folder) for row in x], at, x)


def test_errors_that_conditions_share_are_counted_once(tmp_path):
    """A shift that both conditions share cancels in their difference, as dense algebra says."""

    def found_and_expected(*, shared):
        noise = {"sd": 10, "unit": "um", "unknown": {"shift": 200, "shared": shared}}
        content = {**TWO_LOADS_STUDY, "discrepancy": {"normal_offset": {}}, "noise": noise}
        study = load_study(write_study(tmp_path, **content))
        record, slopes = run_with_slopes(study, np.array([400.0]), tmp_path)
        errors = study.noise_of("light")
        # Between the nodes: at a corner of the simulated polyline the signed distance has a kink.
        points = {name: record.interfaces[name].points for name in ("light", "heavy")}
        seen = {name: Interface.polyline(0.5 * (p[1:] + p[:-1])) for name, p in points.items()}
        middle = np.concatenate([one.points for one in seen.values()]).mean(axis=0)
        models = [errors.model(one, middle=middle) for one in seen.values()]
        C = np.diag(np.concatenate([one.local for one in models]))
        B = np.vstack([one.shared for one in models]) if shared else block_diag(*[one.shared for one in models])
        J = []
        for name, p in points.items():
            across = np.diff(p, axis=0)[:, ::-1] * [-1, 1]
            slope = 0.5 * (slopes[name][1:, :, 0] + slopes[name][:-1, :, 0])
            J.append((across / np.linalg.norm(across, axis=1)[:, None] * slope).sum(axis=1))
        J = np.concatenate(J)
        information = J @ np.linalg.solve(C + B @ B.T, J) + 1 / (0.3413 * 260) ** 2
        return expected_sd(study, record.interfaces, slopes, seen), float(information**-0.5)

    (together,), expected_together = found_and_expected(shared=True)
    (apart,), expected_apart = found_and_expected(shared=False)
    assert [together, apart] == pytest.approx([expected_together, expected_apart], rel=0.05)
    assert together / apart == pytest.approx(expected_together / expected_apart, rel=0.01)
    assert expected_together < 0.95 * expected_apart


def test_widths_by_squared_distances_are_those_of_dense_algebra(tmp_path):
    study = load_study(write_study(tmp_path))
    record, slopes = run_with_slopes(study, AT, tmp_path)
    J = slopes[""].reshape(-1, 2)
    information = J.T @ J / 0.003**2 + np.diag(1 / (0.3413 * np.array([260.0, 0.04])) ** 2)
    expected = np.sqrt(np.diag(np.linalg.inv(information)))
    assert expected_sd(study, record.interfaces, slopes, {}) == pytest.approx(expected, rel=0.02)


@pytest.mark.filterwarnings("ignore:.*invalid value:RuntimeWarning")
def test_slopes_that_are_not_finite_are_refused(tmp_path):
    study = load_study(write_study(tmp_path))
    record = run(study, AT, tmp_path)
    slopes = np.full((*record.interface.points.shape, 2), np.nan)
    for some in ({"": slopes}, {"": np.ones(slopes.shape), "unseen": slopes}):
        with pytest.raises(NumericsError, match="no finite widths"):
            expected_sd(study, record.interfaces, some, {})


def test_what_the_data_barely_constrain_is_said_and_runs_without_slopes_give_none(tmp_path):
    study = load_study(write_study(tmp_path))
    lines = list(widths.width_lines(study, np.array([5.0, 0.0113]), "2 more runs"))
    assert lines[0].startswith("expected posterior (linearised, from 2 more runs): E ± 5 (")
    assert lines[1] == "warning: with this noise the data barely constrain tilt"
    record = run(study, AT, tmp_path)
    assert widths.slopes_by_sensitivities(record, study.space.names) is None
    own = {"": {name: np.full_like(record.interface.points, i) for i, name in enumerate(study.space.names)}}
    slopes = widths.slopes_by_sensitivities(replace(record, sensitivities=own), study.space.names)
    np.testing.assert_array_equal(slopes[""][0], [[0.0, 1.0], [0.0, 1.0]])
    assert widths.slopes_by_sensitivities(replace(record, sensitivities=own), [*study.space.names, "load"]) is None
    assert predicted_at([record] * 2, study.space, AT) is None


def test_a_surrogate_of_a_few_runs_gives_the_same_widths(tmp_path):
    study = load_study(write_study(tmp_path, discrepancy={"normal_offset": {}}, noise={"sd": 3, "unit": "um"}))
    records = [attempt(study.model, RunRequest("key", inputs), tmp_path) for inputs in study.runs.design[:12]]
    record, slopes = run_with_slopes(study, AT, tmp_path)
    by_field = expected_sd(study, *predicted_at(records, study.space, AT), {})
    np.testing.assert_allclose(by_field, expected_sd(study, record.interfaces, slopes, {}), rtol=0.3)


@pytest.mark.stand_in
def test_the_effect_of_an_outline_lacks_widths_where_no_run_succeeded_or_the_noise_is_inferred(tmp_path):
    outline = SimpleNamespace(errors=PointErrors(0.002, 0.01))
    for noise, records in (({"sd": "unknown", "unit": "um"}, "all"), ({"sd": 3, "unit": "um"}, "none")):
        content = {"discrepancy": {"normal_offset": {}}, "surrogate": {"field": {}}, "noise": noise}
        study = load_study(write_study(tmp_path, **content))
        study = replace(study, undeformed=outline, noises={"": study.noise})
        runs = [run(study, AT, tmp_path)] if records == "all" else []
        assert widths.outline_effect(study, runs, None) == {"sd_um": 2.0, "length_um": 10.0, "offset_um": 0.0}


def test_slopes_from_runs_hold_at_the_place_and_not_in_the_mean():
    """Planted in the mean over the box: a second-order effect, which a linear fit spreads over both inputs."""
    t, random = np.linspace(0.0, 1.0, 9), np.random.default_rng(1)

    def height(a, b):
        return a * t + b * t**2 + 0.5 * a * b * t + 0.3 * a**2

    def record(a, b):
        return RunRecord(f"{a}", {"a": a, "b": b}, "ok", {"": Interface.polyline(np.stack([t, height(a, b)], axis=1))})

    records = [record(*row) for row in random.uniform(0.0, 2.0, size=(12, 2)).tolist()]
    space = ParameterSpace((Parameter("a", Uniform(0.0, 2.0)), Parameter("b", Uniform(0.0, 2.0))))
    for a, b in ((1.0, 1.0), (1.4, 0.6)):
        slopes = predicted_at(records, space, np.array([a, b]))[1][""]
        np.testing.assert_allclose(slopes[:, 1, 0], t + 0.5 * b * t + 0.6 * a, atol=0.05)
        np.testing.assert_allclose(slopes[:, 1, 1], t**2 + 0.5 * a * t, atol=0.05)


def test_neighbours_differ_by_a_share_of_the_box():
    space = ParameterSpace((Parameter("a", Uniform(10.0, 12.0)), Parameter("b", Uniform(0.0, 1.0))))
    found = neighbours(space, np.array([11.0, 1.0]))
    np.testing.assert_allclose(found - [11.0, 1.0], [[2 * STEP, 0.0], [0.0, -STEP]])
