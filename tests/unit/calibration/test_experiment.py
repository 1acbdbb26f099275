"""Repeated experiments: the errors that are drawn, those that conditions share, and what the errors let one know."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.unit.calibration.arches import SD, SPACE, TRACKED, TRUTH, arch, knowledge, seen

from strandline.calibration.coverage import repeatable
from strandline.calibration.experiment import CoordinateErrors, Experiment
from strandline.calibration.source import prior_source
from strandline.discrepancy import ClosestPoint, Currents, Discrepancy, NormalOffset, signed_distances
from strandline.errors import InvalidInput
from strandline.interface import GaussianNoise, Interface, Noise, Observation, PointErrors
from strandline.likelihood import compared
from strandline.likelihood.registered import Registered

ERRORS = PointErrors(SD, 0.1, shift=0.02, rotation=1.0, offset=0.01)
TO_SIMULATED = ClosestPoint(direction="to_simulated")
OFFSET = NormalOffset()


@cache
def experiment(
    noise: Noise | PointErrors, measure: Discrepancy = OFFSET, conditions: tuple[str, ...] = ("",)
) -> Experiment:
    """Return the experiment behind an arch, or behind several: "1", "1.5"."""
    observations = {name: Observation(seen(PointErrors(SD), float(name or 1.0)), noise, name) for name in conditions}
    return repeatable(prior_source(knowledge(measure, observations), SPACE, number=256))


def test_stated_errors_are_drawn_and_analysed_with_the_noise_of_the_real_observation() -> None:
    assert experiment(ERRORS).errors[""] == experiment(ERRORS).noises[""] == ERRORS
    for errors in (PointErrors(SD), PointErrors(SD, offset=0.02)):
        found, real = experiment(errors, TO_SIMULATED), seen(PointErrors(SD))
        repeated = compared(Observation(real.resampled(37), found.noises[""]), TO_SIMULATED, 41)
        expected = compared(Observation(real, errors), TO_SIMULATED, 41)
        assert found.errors[""] == errors
        assert repeated.noise == expected.noise
        if errors.offset:
            assert isinstance(repeated.measure, Registered)
            assert isinstance(expected.measure, Registered)
            assert repeated.measure.variance == expected.measure.variance


def test_errors_of_a_variance_are_those_for_which_it_is_right(monkeypatch: pytest.MonkeyPatch) -> None:
    for measure, kind in ((TO_SIMULATED, PointErrors), (TRACKED, CoordinateErrors), (OFFSET, PointErrors)):
        found = experiment(GaussianNoise(SD**2), measure).errors[""]
        assert isinstance(found, kind)
        assert found.sd == pytest.approx(SD, rel=1e-6)
    mean = ClosestPoint(direction="to_simulated", weighting="length")
    errors = experiment(GaussianNoise(1e-6), mean).errors[""]
    assert isinstance(errors, PointErrors)
    assert mean.noise_variance(errors, seen(PointErrors(SD))) == pytest.approx(1e-6, rel=1e-6)

    def refuse(*given: object) -> float:
        raise InvalidInput("noise", value=1, expected="less", remedy="None.")

    monkeypatch.setattr("strandline.calibration.experiment.stated_errors", refuse)
    with pytest.raises(InvalidInput, match="State these errors"):
        experiment(GaussianNoise(1e-4), Currents(0.1))


def test_truths_are_observed_where_the_real_one_was_and_off_by_the_stated_errors() -> None:
    found, random = experiment(PointErrors(SD)), np.random.default_rng(2)
    (true,) = found.truths(np.array([0.25, 0.1])).values()
    np.testing.assert_allclose(true.points, arch(np.array([0.25, 0.1])).points, atol=1e-3)
    truths = found.truths(TRUTH)
    off = [signed_distances(found.observed(truths, random)[0].interface.points, truths[""]) for _ in range(40)]
    assert np.std(off) == pytest.approx(SD, rel=0.1)


def middles(found: Experiment) -> np.ndarray:
    """Return how far the middle of each condition is from the true one."""
    random, truths = np.random.default_rng(4), found.truths(TRUTH)
    drawn = [found.observed(truths, random) for _ in range(30)]
    return np.array(
        [[one.interface.points.mean(axis=0) - truths[one.condition].points.mean(axis=0) for one in o] for o in drawn]
    )


def test_shared_errors_are_the_same_in_all_conditions() -> None:
    errors = PointErrors(1e-4, shift=0.02, shared=True)
    together = middles(experiment(errors, conditions=("1", "1.5")))
    np.testing.assert_allclose(together[:, 0], together[:, 1], atol=2e-3)
    assert together.std() == pytest.approx(0.02, rel=0.4)
    apart = middles(experiment(replace(errors, shared=False), conditions=("1", "1.5")))
    assert np.abs(apart[:, 0] - apart[:, 1]).max() > 0.02


def slopes(factor: float = 1.0, step: float = 1e-5) -> np.ndarray:
    """Return the derivatives of the points of an arch, (point, xyz, dim)."""
    changes = [arch(TRUTH + step * e, factor).points - arch(TRUTH - step * e, factor).points for e in np.eye(2)]
    return np.stack(changes, axis=2) / (2 * step)


def across(true: Interface, factor: float = 1.0) -> np.ndarray:
    """Return the derivatives of the points along the normals, (point, dim)."""
    normals = true.normals
    ends = np.concatenate([normals[:1], 0.5 * (normals[1:] + normals[:-1]), normals[-1:]])
    return np.asarray(np.einsum("px,pxd->pd", ends / np.linalg.norm(ends, axis=1)[:, None], slopes(factor)))


@pytest.mark.parametrize(
    ("errors", "conditions"),
    [(ERRORS, ("",)), (PointErrors(SD, shift=0.1, shared=True), ("1", "1.5"))],
    ids=["one", "shared by two"],
)
def test_the_information_is_that_of_the_dense_covariance(errors: PointErrors, conditions: tuple[str, ...]) -> None:
    found = experiment(errors, conditions=conditions)
    truths = found.truths(TRUTH)
    models = [errors.model(true) for true in truths.values()]
    B = np.concatenate([one.shared for one in models])
    J = np.concatenate([across(true, float(name or 1.0)) for name, true in truths.items()])
    expected = J.T @ np.linalg.solve(np.diag(np.concatenate([one.local for one in models])) + B @ B.T, J)
    np.testing.assert_allclose(found.information(TRUTH, truths), expected, rtol=0.06, atol=0.03 * expected.max())


def test_the_information_of_tracked_points() -> None:
    found = experiment(GaussianNoise(SD**2), TRACKED)
    J = slopes().reshape(-1, 2)
    expected = J.T @ J / SD**2
    information = found.information(TRUTH, found.truths(TRUTH))
    np.testing.assert_allclose(information, expected, rtol=0.03, atol=0.02 * expected.max())
