"""The likelihood through a surrogate of the field, against brute force and closed forms."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.unit.discrepancy.curves import graph
from tests.unit.likelihood.near_arches import widened

from strandline.discrepancy import ClosestPoint, Discrepancy, NormalOffset, TrackedPoints
from strandline.interface import Interface, Observation, PointErrors
from strandline.likelihood import FieldLikelihood, noise_length
from strandline.surrogate.field import FieldTraining, fit_field
from strandline.testing.models import TwoLoads

NOISE = 0.1
RUNS = np.linspace(320.0, 540.0, 6)[:, None]
AT = np.array([[330.0], [401.0], [470.0], [550.0]])
WIDE = 3e5
"""Makes the variance of the field count for as much as the noise."""


def interfaces(E: float) -> dict[str, Interface]:
    return dict(TwoLoads()({"E": E, "load": 1e-5}, Path()).interfaces)


@cache
def likelihood(measure: Discrepancy = TrackedPoints()) -> FieldLikelihood:  # noqa: B008
    """Return log L of E from two outlines of a beam, learnt from few runs; its displacement goes with 1/E: one mode."""
    runs = [interfaces(float(E)) for E in RUNS[:, 0]]
    surrogate = fit_field(FieldTraining(RUNS, runs, None, np.array([300.0]), np.array([560.0])))
    observations = tuple(Observation(one, NOISE**2, name) for name, one in interfaces(400.0).items())
    return FieldLikelihood(surrogate, observations, measure)


def with_tail(found: FieldLikelihood, size: float) -> FieldLikelihood:
    """Return the likelihood with two further modes of this standard deviation, for what the first one leaves."""
    modes = found.surrogate.modes
    rows = np.random.default_rng(3).standard_normal((3, modes.basis.shape[1]))
    rows[0] = modes.basis[0]
    rest = np.linalg.qr(rows.T)[0].T[1:]
    return replace(found, surrogate=replace(found.surrogate, modes=replace(modes, tail=size * rest)))


def test_plug_in_is_the_measure_on_the_predicted_interface():
    found = likelihood(ClosestPoint())
    for x, value in zip(AT, found.plug_in(AT), strict=True):
        predicted = found.surrogate.interfaces(x)
        squares = [found.discrepancy(predicted[o.condition], o.interface) for o in found.observations]
        assert value == pytest.approx(-0.5 * sum(squares) / NOISE**2, rel=1e-9)
    known = widened(likelihood(), 0.0)
    np.testing.assert_allclose(known.expected(AT), known.plug_in(AT), rtol=1e-9, atol=1e-7)


def by_draws(found: FieldLikelihood, number: int = 20_000) -> tuple[np.ndarray, np.ndarray]:
    """Return log E[L] by independent draws of all modes and of what they leave, and its standard errors."""
    rng, surrogate = np.random.default_rng(1), found.surrogate
    seen, values, errors = np.concatenate([o.interface.points.ravel() for o in found.observations]), [], []
    for x in AT:
        predicted = surrogate.predict(x[None])
        drawn = predicted.mean + np.sqrt(predicted.variance) * rng.standard_normal((number, predicted.mean.shape[1]))
        tail = rng.standard_normal((number, len(surrogate.modes.tail))) @ surrogate.modes.tail
        fields = surrogate.modes.mean + (drawn @ surrogate.modes.basis + tail) / surrogate.modes.roots
        L = np.exp(-0.5 * np.sum((fields - seen) ** 2, axis=1) / found.observations[0].noise.scale)
        values.append(np.log(L.mean()))
        errors.append(L.std() / L.mean() / np.sqrt(number))
    return np.array(values), np.array(errors)


@pytest.mark.parametrize("tail", [0.0, 0.005])
def test_expected_is_the_mean_over_all_fields(tail: float):
    """Sixteen fields for twenty thousand. Planted: variances of a quarter show."""
    found = with_tail(widened(likelihood(), WIDE), tail)
    exact, errors = by_draws(found)
    assert errors.max() < 0.04
    plug_in, expected = found.plug_in(AT), found.expected(AT)
    assert np.abs(exact - plug_in).max() > 0.3
    assert np.abs(exact - expected).max() < 0.1 + 0.1 * np.abs(exact - plug_in).max()
    assert np.abs(exact - with_tail(widened(likelihood(), WIDE / 4), tail).expected(AT)).max() > 0.3


def test_left_out_is_predicted_from_the_others():
    """At the runs themselves the field is known; a run that is left out is a worse place."""
    found, runs = likelihood(), [interfaces(float(E)) for E in RUNS[:, 0]]
    true = [-50 * sum(found.discrepancy(run[o.condition], o.interface) for o in found.observations) for run in runs]
    at_runs, left_out = found.expected(RUNS), found.left_out(np.arange(6))[0]
    assert np.abs(at_runs - true).max() < 0.02 * np.abs(left_out - true).max()
    np.testing.assert_array_equal(found.left_out(np.array([4, 1]))[0], left_out[[4, 1]])


def test_the_variance_is_that_of_the_log_likelihood_of_possible_fields():
    """It is that of 4000 fields drawn at each point, and at least twice as large at a run that is left out."""
    found, x = likelihood(), np.array([[335.0], [402.0]])
    predicted = found.surrogate.predict(x)
    z = np.random.default_rng(1).standard_normal((4000, 2, predicted.mean.shape[1]))
    fields = predicted.mean + np.sqrt(predicted.variance) * z
    drawn = np.stack([found.at(fields[:, k]).var() for k in range(2)])
    np.testing.assert_allclose(found.variances(x), drawn, rtol=0.15)
    assert (found.variances(RUNS) < 0.5 * found.left_out(np.arange(6))[1]).all()


def test_the_noise_length_of_tracked_points():
    """A shift δ of n nodes has d² = n δ², so that d² = σ_N² at δ = σ_N/√n; it is half the extent at most."""
    line = graph(np.linspace(0.0, 2.0, 21), 0.0)
    assert noise_length(Observation(line, 0.01**2), TrackedPoints()) == pytest.approx(0.01 / np.sqrt(21), rel=1e-5)
    assert noise_length(Observation(line, 1e6), TrackedPoints()) == pytest.approx(1.0)


def test_the_noise_length_of_a_flat_strip_is_that_across_it_if_shifts_count_by_the_inverse():
    """It slides along itself nearly unseen, but hardly across."""
    seen = Observation(graph(np.linspace(0.0, 2.0, 21), 0.0), PointErrors(0.01))
    across = 0.01 / np.sqrt(21)
    assert noise_length(seen, NormalOffset()) > 20 * across
    assert noise_length(seen, NormalOffset(), of=min) == pytest.approx(across, rel=0.01)
    random = noise_length(seen, NormalOffset(), of=lambda shifts: np.mean(np.square(shifts) ** -1.0) ** -0.5)
    assert random == pytest.approx(np.sqrt(2) * across, rel=0.01)


def test_the_noise_length_is_that_of_the_local_noise_however_small_and_however_many_the_points():
    """A stated shift leaves the shape as well known; neighbours on a rough outline err together."""

    def found(outline, errors):
        return noise_length(Observation(outline, errors), NormalOffset())

    angle, fine = np.linspace(0.0, np.pi, 41), np.linspace(-2.6, 2.6, 1500)
    arc, radius = graph(np.cos(angle), np.sin(angle)), 1.35 + 1.3e-3 * np.sin(150 * fine)
    small, shifted, large = (found(arc, PointErrors(sd, shift=s)) for sd, s in ((1e-9, 0.0), (1e-9, 0.1), (1e-3, 0.1)))
    assert small == shifted == pytest.approx(1e-6 * large, rel=0.01)
    rough, correlated = graph(radius * np.sin(fine), -radius * np.cos(fine)), PointErrors(1.3e-3, 0.039)
    few = found(Interface.polyline(rough.points[::3]), correlated)
    assert found(rough, correlated) == pytest.approx(few, rel=0.1)
