"""Repeated experiments: ranks are uniform if noise and likelihood belong together; errors drawn, and where they lie."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import log_softmax, logsumexp
from scipy.stats import norm
from tests.unit.calibration.arches import SD, SPACE, TRACKED, TRUTH, arch, knowledge, seen
from tests.unit.discrepancy.surfaces import sheet

from strandline.calibration import importance_sampler
from strandline.calibration.coverage import CoverageFound, Replicate, repeatable, replicated
from strandline.calibration.experiment import CoordinateErrors, field_quality, footprint, posterior_source, prior_source
from strandline.discrepancy import ClosestPoint, NormalOffset, signed_distances
from strandline.foundations import InvalidInput
from strandline.interface import GaussianNoise, Interface, Observation, PointErrors
from strandline.likelihood import compared
from strandline.posterior import Posterior

NOISE = GaussianNoise(0.03**2)


@cache
def known(noise, measure):
    errors = noise if isinstance(noise, PointErrors) else PointErrors(SD)
    return knowledge(measure, {"": Observation(seen(errors), noise)})


def from_prior(noise, measure):
    """Return what draws truths from the prior; 512 draws are enough to begin with, for the box is small."""
    return prior_source(known(noise, measure), SPACE, number=512)


def repeated(source, analysed=None, number=12):
    """Repeat the experiment; `analysed` plants another noise in the analysis. Twelve show what is badly wrong."""
    experiment = repeatable(source)
    if analysed is not None:
        experiment = replace(experiment, noises={"": analysed})
    return CoverageFound(SPACE.names, tuple(replicated(experiment, source, seed=1, number=k) for k in range(number)))


def least_p(found):
    return min(band.p_value for band in (*found.bands, found.fit_band))


@pytest.mark.repeats
def test_right_noise_gives_uniform_ranks():
    for noise, measure in (
        (PointErrors(SD, 0.1, shift=0.02, rotation=1.0, offset=0.01), NormalOffset()),
        (GaussianNoise(SD**2), ClosestPoint(direction="to_simulated")),
        (GaussianNoise(SD**2), TRACKED),
    ):
        found = repeated(from_prior(noise, measure))
        assert least_p(found) > 1e-3, measure
        assert np.abs(found.z.std(axis=0) - 1).max() < 0.5
        assert 0.8 < found.of_limit.min() <= found.of_limit.max() < 1.5


@pytest.mark.repeats
def test_wrong_noise_shows():
    """Planted: 2ℓ/h forgotten, the shift dropped, the offset dropped, σ given for σ²."""
    for noise, analysed, word in (
        (PointErrors(SD, 0.12), PointErrors(SD), "narrow"),
        (PointErrors(SD, shift=0.05), PointErrors(SD), "narrow"),
        (PointErrors(SD, 0.1, offset=0.03), PointErrors(SD, 0.1), "narrow"),
        (PointErrors(SD), GaussianNoise(SD), "wide"),
    ):
        found = repeated(from_prior(noise, NormalOffset()), analysed)
        assert not found.calibrated
        assert any(word in remark for remark in found.remarks), noise


def test_a_replicate_depends_on_seed_and_number_alone_and_tempering_takes_over(monkeypatch):
    source = from_prior(GaussianNoise(SD**2), TRACKED)
    experiment = repeatable(source)
    first = replicated(experiment, source, seed=1, number=3)
    replicated(experiment, source, seed=1, number=0)
    np.testing.assert_equal(vars(replicated(experiment, source, seed=1, number=3)), vars(first))
    for seed, number in ((2, 3), (1, 4)):
        assert (replicated(experiment, source, seed=seed, number=number).truth != first.truth).any()
    monkeypatch.setattr(importance_sampler, "followed", lambda *given, **options: None)
    other = replicated(experiment, source, seed=1, number=3)
    assert (first.by, other.by) == ("importance", "smc")
    np.testing.assert_array_equal(other.truth, first.truth)
    assert np.abs((other.mean - first.mean) / first.sd).max() < 0.3


@cache
def stored():
    """Return the posterior of the real observation as weighted draws of the prior."""
    draws = SPACE.prior_quantiles(np.random.default_rng(9).random((30000, 2)))
    values = known(NOISE, TRACKED).plug_in(draws)
    log_prior, log_evidence = np.asarray(SPACE.log_prior(draws)), float(logsumexp(values) - np.log(30000))
    return Posterior(SPACE, draws, np.asarray(log_softmax(values)), values, log_prior, log_evidence)


def test_truths_from_the_posterior():
    """Planted: a noise variance 16 times too small."""
    source = posterior_source(known(NOISE, TRACKED), stored())
    found = repeated(source)
    assert least_p(found) > 1e-3
    after = np.sqrt(np.diag(source.covariance))
    assert (found.sd < 0.9 * after).all()  # the repeated observation adds to the real one
    spread = np.array([one.truth for one in found.replicates]).std(axis=0)
    assert (np.abs(spread / after - 1) < 0.5).all()
    assert not repeated(source, GaussianNoise(NOISE.variance / 16)).calibrated


def test_the_density_of_a_source_is_normalised():
    found = known(NOISE, TRACKED)
    u = (np.stack(np.meshgrid(np.arange(60), np.arange(60), indexing="ij"), axis=-1).reshape(-1, 2) + 0.5) / 60
    x, cell = SPACE.to_physical(u), np.prod(SPACE.high - SPACE.low) / 60**2
    for source, error in ((prior_source(found, SPACE), 1e-9), (posterior_source(found, stored()), 0.25)):
        mass = np.exp(source.log_density(x, found.surrogate.mean(x))).sum() * cell
        assert mass == pytest.approx(1.0, abs=error)
    with pytest.raises(InvalidInput, match="disagree"):
        posterior_source(found, replace(stored(), log_likelihood=-20 * stored().log_likelihood))


def test_a_coarse_surrogate_is_noticed():
    source = from_prior(GaussianNoise(SD**2), TRACKED)
    good, found = field_quality(source), source.knowledge
    assert good.good
    wider = tuple(replace(process, widening=1e16) for process in found.surrogate.processes)
    likelihood = replace(found.likelihood, surrogate=replace(found.surrogate, processes=wider))
    coarse = field_quality(replace(source, knowledge=replace(found, likelihood=likelihood)))
    assert (coarse.good, coarse.hidden) == (False, good.hidden)
    assert coarse.beyond > 0.5


def gaussians(shift=0.0, width=1.0, fit=1.0):
    """Return what posteriors show whose z-scores are Gaussian; `fit` is the power of the ranks of the likelihood."""
    random, even = np.random.default_rng(3), (np.arange(200) + 0.5) / 200
    first, second, fits = (random.permutation(even) for _ in range(3))
    z = np.stack([norm.ppf(first), shift + width * norm.ppf(second)], axis=1)
    one, half = np.ones(2), np.full(2, 0.5)
    made = [
        Replicate(k, row, np.asarray(norm.cdf(row)), rank, 0 * one, one, half, 500.0, "importance")
        for k, (row, rank) in enumerate(zip(z, fits**fit, strict=True))
    ]
    return CoverageFound(("E", "nu"), tuple(made))


def test_the_verdict_in_words():
    for wrong, how, words in (
        ({}, "calibrated", "all ranks stay inside the 95 % band."),
        ({"fit": 3.0}, "too narrow", "the truth is among the 90 % of its draws that fit best in 53.5 % of"),
        ({"width": 0.5}, "too wide", "90 % intervals of nu contain the truth in 100 % of"),
        ({"shift": 0.6}, "shifted", "means of nu are 0.6 standard deviations too low."),
    ):
        assert gaussians(**wrong).verdict.startswith(f"The posterior is {how}: {words}")


ERRORS = PointErrors(SD, 0.1, shift=0.02, rotation=1.0, offset=0.01)
TO_SIMULATED, OFFSET = ClosestPoint(direction="to_simulated"), NormalOffset()


@cache
def experiment(noise, measure=OFFSET, conditions=("",)):
    """Return the experiment behind an arch, or behind several: "1", "1.5"."""
    observations = {name: Observation(seen(PointErrors(SD), float(name or 1.0)), noise, name) for name in conditions}
    return repeatable(prior_source(knowledge(measure, observations), SPACE, number=256))


def test_stated_errors_are_drawn_and_analysed_with_the_noise_of_the_real_observation():
    errors = PointErrors(SD, offset=0.02)
    found, real = experiment(errors, TO_SIMULATED), seen(PointErrors(SD))
    repeated = compared(Observation(real.resampled(37), found.noises[""]), TO_SIMULATED, 41)
    expected = compared(Observation(real, errors), TO_SIMULATED, 41)
    assert (found.errors[""], repeated.noise) == (errors, expected.noise)
    assert repeated.measure.variance == expected.measure.variance


def test_errors_of_a_variance_are_those_for_which_it_is_right():
    for measure, kind in ((TO_SIMULATED, PointErrors), (TRACKED, CoordinateErrors), (OFFSET, PointErrors)):
        found = experiment(GaussianNoise(SD**2), measure).errors[""]
        assert isinstance(found, kind)
        assert found.sd == pytest.approx(SD, rel=1e-6)


def middles(found):
    """Return how far the middle of each condition is from the true one."""
    random, truths = np.random.default_rng(4), found.truths(TRUTH)
    drawn = [found.observed(truths, random) for _ in range(30)]
    true = {name: one.points.mean(axis=0) for name, one in truths.items()}
    return np.array([[one.interface.points.mean(axis=0) - true[one.condition] for one in seen] for seen in drawn])


def test_truths_are_observed_with_the_stated_errors_which_conditions_may_share():
    found, random = experiment(PointErrors(SD)), np.random.default_rng(2)
    truths = found.truths(TRUTH)
    off = [signed_distances(found.observed(truths, random)[0].interface.points, truths[""]) for _ in range(40)]
    assert np.std(off) == pytest.approx(SD, rel=0.1)
    errors = PointErrors(1e-4, shift=0.02, shared=True)
    together = middles(experiment(errors, conditions=("1", "1.5")))
    np.testing.assert_allclose(together[:, 0], together[:, 1], atol=2e-3)
    assert together.std() == pytest.approx(0.02, rel=0.4)
    apart = middles(experiment(replace(errors, shared=False), conditions=("1", "1.5")))
    assert np.abs(apart[:, 0] - apart[:, 1]).max() > 0.02


def across(true, factor=1.0, step=1e-5):
    """Return the derivatives of the points of an arch along its normals, (point, dim)."""
    changes = [arch(TRUTH + step * e, factor).points - arch(TRUTH - step * e, factor).points for e in np.eye(2)]
    normals = true.normals
    ends = np.concatenate([normals[:1], 0.5 * (normals[1:] + normals[:-1]), normals[-1:]])
    return np.einsum("px,dpx->pd", ends / np.linalg.norm(ends, axis=1)[:, None], changes) / (2 * step)


def test_the_information_is_that_of_the_dense_covariance():
    """Of one condition, and of errors that two share."""
    for errors, conditions in ((ERRORS, ("",)), (PointErrors(SD, shift=0.1, shared=True), ("1", "1.5"))):
        found = experiment(errors, conditions=conditions)
        truths = found.truths(TRUTH)
        models = [errors.model(true) for true in truths.values()]
        B = np.concatenate([one.shared for one in models])
        J = np.concatenate([across(true, float(name or 1.0)) for name, true in truths.items()])
        expected = J.T @ np.linalg.solve(np.diag(np.concatenate([one.local for one in models])) + B @ B.T, J)
        np.testing.assert_allclose(found.information(TRUTH, truths), expected, rtol=0.06, atol=0.03 * expected.max())


def test_a_part_stays_that_part_when_the_interface_moves_and_noise_changes_no_order():
    t, shift, random = np.linspace(0.0, 1.0, 401), np.array([0.2, -0.4]), np.random.default_rng(2)
    whole = Interface.polyline(np.stack([t, 0.3 * np.sin(np.pi * t)], axis=1))
    part = Interface.polyline(whole.points[100:301:5])
    found = footprint(part, whole)
    np.testing.assert_allclose(found.on(whole.points), part.points, atol=2e-4)
    np.testing.assert_allclose(found.on(whole.points + shift), found.on(whole.points) + shift, atol=1e-12)
    part = whole.points[40:361:4]
    noisy = Interface.polyline(part + 0.0015 * random.standard_normal(part.shape))
    laid = Interface.polyline(footprint(noisy, whole).on(whole.points))
    assert (laid.normals @ np.array([0.0, 1.0]) > 0).all()
    assert laid.lengths.min() > 0.2 * np.median(laid.lengths)


def test_a_closed_outline_may_begin_anywhere_and_a_part_may_pass_its_beginning():
    angle = 2 * np.pi * np.arange(-60, 60) / 120
    points = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    whole = Interface.polyline(np.roll(points, 60, axis=0), closed=True)
    turned = Interface.polyline(np.roll(points[::2], -17, axis=0), closed=True)
    for outline, error in ((turned, 1e-9), (Interface.polyline(points[40:80:2]), 2e-3)):
        np.testing.assert_allclose(footprint(outline, whole).on(whole.points), outline.points, atol=error)


def test_points_of_a_surface_keep_their_place_in_its_triangles():
    whole, observed, stretch = sheet(6, bend=0.1), sheet(9, bend=0.1, seed=3), np.array([2.0, 1.0, 1.0])
    found = footprint(observed, whole)
    np.testing.assert_allclose(found.weights.sum(axis=1), 1.0, rtol=1e-12)
    assert found.weights.min() > -1e-9
    laid = found.on(whole.points)
    assert np.linalg.norm(laid - observed.points, axis=1).max() < 0.05
    np.testing.assert_allclose(found.on(whole.points * stretch), laid * stretch, atol=1e-12)
