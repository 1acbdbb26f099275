"""Repeated experiments: the errors that are drawn, those that conditions share, and what the errors let one know."""

from dataclasses import replace

import numpy as np
import pytest
from tests.calibration.arches import SD, SPACE, TRUTH, arch, knowledge, seen

from strandline.calibration.coverage import repeatable
from strandline.calibration.experiment import CoordinateErrors, Experiment
from strandline.calibration.source import prior_source
from strandline.discrepancy import ClosestPoint, Currents, Discrepancy, NormalOffset, TrackedPoints, signed_distances
from strandline.errors import InvalidInput
from strandline.interface import GaussianNoise, Interface, Noise, Observation, PointErrors
from strandline.likelihood import compared
from strandline.likelihood.registered import Registered


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("strandline.calibration.source.POINTS", 256)


def experiment(noise: Noise | PointErrors, measure: Discrepancy, **others: Noise | PointErrors) -> Experiment:
    """Return the experiment behind an arch, or behind several: "1", "1.5"."""
    noises = others or {"": noise}
    observations = {
        name: Observation(seen(PointErrors(SD), float(name or 1.0)), one, name) for name, one in noises.items()
    }
    return repeatable(prior_source(knowledge(measure, observations), SPACE))


def test_stated_errors_are_drawn_and_analysed() -> None:
    errors = PointErrors(SD, 0.1, offset=0.02)
    found = experiment(errors, NormalOffset())
    assert found.errors[""] == errors
    assert found.noises[""] == errors


@pytest.mark.parametrize("errors", [PointErrors(SD), PointErrors(SD, offset=0.02)])
def test_stated_errors_keep_their_noise_for_other_measures(errors: PointErrors) -> None:
    """It is that of the real observation, not computed again for each."""
    measure = ClosestPoint(direction="to_simulated")
    found, real = experiment(errors, measure), Observation(seen(PointErrors(SD)), errors)
    repeated = compared(Observation(seen(PointErrors(SD)).resampled(37), found.noises[""]), measure, 41)
    expected = compared(real, measure, 41)
    assert found.errors[""] == errors
    assert repeated.noise == expected.noise
    if errors.offset:
        assert isinstance(repeated.measure, Registered)
        assert isinstance(expected.measure, Registered)
        assert repeated.measure.variance == expected.measure.variance


def test_errors_of_a_variance_are_those_for_which_it_is_right() -> None:
    sums = experiment(GaussianNoise(SD**2), ClosestPoint(direction="to_simulated")).errors[""]
    assert isinstance(sums, PointErrors)
    assert sums.sd == pytest.approx(SD, rel=1e-6)
    observed, mean = seen(PointErrors(SD)), ClosestPoint(direction="to_simulated", weighting="length")
    found = experiment(GaussianNoise(1e-6), mean).errors[""]
    assert isinstance(found, PointErrors)
    assert mean.noise_variance(found, observed) == pytest.approx(1e-6, rel=1e-6)


@pytest.mark.parametrize(("measure", "kind"), [(TrackedPoints(), CoordinateErrors), (NormalOffset(), PointErrors)])
def test_errors_of_sums_of_squares(measure: Discrepancy, kind: type) -> None:
    found = experiment(GaussianNoise(SD**2), measure).errors[""]
    assert isinstance(found, kind)
    assert found.sd == pytest.approx(SD)


def test_a_variance_that_no_errors_have_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*given: object) -> float:
        raise InvalidInput("noise", value=1, expected="less", remedy="None.")

    monkeypatch.setattr("strandline.calibration.experiment.stated_errors", refuse)
    with pytest.raises(InvalidInput, match="State these errors"):
        experiment(GaussianNoise(1e-4), Currents(0.1))


def test_truths_are_observed_where_the_real_one_was() -> None:
    found = experiment(PointErrors(SD), NormalOffset())
    (true,) = found.truths(np.array([0.25, 0.1])).values()
    np.testing.assert_allclose(true.points, arch(np.array([0.25, 0.1])).points, atol=1e-3)


def test_drawn_points_are_off_by_the_stated_errors() -> None:
    found, random = experiment(PointErrors(SD), NormalOffset()), np.random.default_rng(2)
    truths = found.truths(TRUTH)
    off = [signed_distances(found.observed(truths, random)[0].interface.points, truths[""]) for _ in range(40)]
    assert np.std(off) == pytest.approx(SD, rel=0.1)


def middles(found: Experiment, number: int = 30) -> np.ndarray:
    """Return how far the middle of each condition is from the true one."""
    random, truths = np.random.default_rng(4), found.truths(TRUTH)
    out = []
    for _ in range(number):
        drawn = found.observed(truths, random)
        out.append([one.interface.points.mean(axis=0) - truths[one.condition].points.mean(axis=0) for one in drawn])
    return np.array(out)


def test_shared_errors_are_the_same_in_all_conditions() -> None:
    errors = PointErrors(1e-4, shift=0.02, shared=True)
    together = middles(experiment(errors, NormalOffset(), **{"1": errors, "1.5": errors}))
    np.testing.assert_allclose(together[:, 0], together[:, 1], atol=2e-3)
    assert together.std() == pytest.approx(0.02, rel=0.4)
    alone = replace(errors, shared=False)
    apart = middles(experiment(alone, NormalOffset(), **{"1": alone, "1.5": alone}))
    assert np.abs(apart[:, 0] - apart[:, 1]).max() > 0.02


def slopes(x: np.ndarray, factor: float = 1.0, step: float = 1e-5) -> np.ndarray:
    """Return the derivatives of the points of an arch, (point, xyz, dim)."""
    changes = [arch(x + step * e, factor).points - arch(x - step * e, factor).points for e in np.eye(2)]
    return np.stack(changes, axis=2) / (2 * step)


def across(true: Interface, factor: float = 1.0) -> np.ndarray:
    """Return the derivatives of the points along the normals, (point, dim)."""
    normals = true.normals
    ends = np.concatenate([normals[:1], 0.5 * (normals[1:] + normals[:-1]), normals[-1:]])
    return np.asarray(np.einsum("px,pxd->pd", ends / np.linalg.norm(ends, axis=1)[:, None], slopes(TRUTH, factor)))


@pytest.mark.parametrize("errors", [PointErrors(SD), PointErrors(SD, 0.1, shift=0.02, rotation=1.0, offset=0.01)])
def test_the_information_is_that_of_the_dense_covariance(errors: PointErrors) -> None:
    found = experiment(errors, NormalOffset())
    truths = found.truths(TRUTH)
    model, J = errors.model(truths[""]), across(truths[""])
    expected = J.T @ np.linalg.solve(np.diag(model.local) + model.shared @ model.shared.T, J)
    np.testing.assert_allclose(found.information(TRUTH, truths), expected, rtol=0.06, atol=0.03 * expected.max())


def test_the_information_of_tracked_points() -> None:
    found = experiment(GaussianNoise(SD**2), TrackedPoints())
    J = slopes(TRUTH).reshape(-1, 2)
    expected = J.T @ J / SD**2
    information = found.information(TRUTH, found.truths(TRUTH))
    np.testing.assert_allclose(information, expected, rtol=0.03, atol=0.02 * expected.max())


def test_the_information_of_conditions_with_shared_errors() -> None:
    errors = PointErrors(SD, shift=0.1, shared=True)
    found = experiment(errors, NormalOffset(), **{"1": errors, "1.5": errors})
    truths = found.truths(TRUTH)
    models = [errors.model(true) for true in truths.values()]
    B = np.concatenate([one.shared for one in models])
    J = np.concatenate([across(true, float(name)) for name, true in truths.items()])
    expected = J.T @ np.linalg.solve(np.diag(np.concatenate([one.local for one in models])) + B @ B.T, J)
    np.testing.assert_allclose(found.information(TRUTH, truths), expected, rtol=0.06, atol=0.03 * expected.max())
