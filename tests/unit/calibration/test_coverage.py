"""Ranks of the truth are uniform if noise and likelihood belong together, and only then."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import log_softmax, logsumexp
from scipy.stats import norm
from tests.unit.calibration.arches import SD, SPACE, TRACKED, knowledge, seen

from strandline.calibration import coverage as module
from strandline.calibration.coverage import CoverageFound, Replicate, repeatable, replicated
from strandline.calibration.field_quality import field_quality
from strandline.calibration.source import Source, posterior_source, prior_source
from strandline.design.active import Knowledge
from strandline.discrepancy import ClosestPoint, Discrepancy, NormalOffset
from strandline.errors import InvalidInput
from strandline.interface import GaussianNoise, Noise, Observation, PointErrors
from strandline.posterior import Posterior
from strandline.posterior.uniformity import weighted_ranks

QUICK = 12
"""Replicates that show what is badly wrong."""
POINTS = 512
"""Draws of the prior to begin with: the box is small."""
NOISE = GaussianNoise(0.03**2)


@cache
def known(noise: Noise | PointErrors, measure: Discrepancy) -> Knowledge:
    errors = noise if isinstance(noise, PointErrors) else PointErrors(SD)
    return knowledge(measure, {"": Observation(seen(errors), noise)})


def from_prior(noise: Noise | PointErrors, measure: Discrepancy) -> Source:
    return prior_source(known(noise, measure), SPACE, number=POINTS)


def repeated(source: Source, analysed: Noise | PointErrors | None = None, number: int = QUICK) -> CoverageFound:
    """Repeat the experiment; `analysed` plants another noise in the analysis."""
    experiment = repeatable(source)
    if analysed is not None:
        experiment = replace(experiment, noises={"": analysed})
    return CoverageFound(SPACE.names, tuple(replicated(experiment, source, seed=1, number=k) for k in range(number)))


def least_p(found: CoverageFound) -> float:
    return min(band.p_value for band in (*found.bands, found.fit_band))


@pytest.mark.parametrize(
    ("noise", "measure"),
    [
        (PointErrors(SD, 0.1, shift=0.02, rotation=1.0, offset=0.01), NormalOffset()),
        (GaussianNoise(SD**2), ClosestPoint(direction="to_simulated")),
        (GaussianNoise(SD**2), TRACKED),
    ],
    ids=["global errors", "closest point", "tracked points"],
)
def test_right_noise_gives_uniform_ranks(noise: Noise | PointErrors, measure: Discrepancy) -> None:
    found = repeated(from_prior(noise, measure))
    assert least_p(found) > 1e-3
    assert np.abs(found.z.std(axis=0) - 1).max() < 0.5
    assert (found.of_limit > 0.8).all()
    assert (found.of_limit < 1.5).all()
    assert all(one.by == "importance" for one in found.replicates)


@pytest.mark.parametrize(
    ("noise", "analysed", "word"),
    [
        (PointErrors(SD, 0.12), PointErrors(SD), "narrow"),
        (PointErrors(SD, shift=0.05), PointErrors(SD), "narrow"),
        (PointErrors(SD, 0.1, offset=0.03), PointErrors(SD, 0.1), "narrow"),
        (PointErrors(SD), GaussianNoise(SD), "wide"),
    ],
    ids=["2ℓ/h forgotten", "shift dropped", "offset dropped", "σ given for σ²"],
)
def test_wrong_noise_shows(noise: PointErrors, analysed: Noise | PointErrors, word: str) -> None:
    """The planted bugs."""
    found = repeated(from_prior(noise, NormalOffset()), analysed)
    assert not found.calibrated
    assert any(word in remark for remark in found.remarks)


def same(one: Replicate, other: Replicate) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in vars(one))


def test_a_replicate_depends_on_seed_and_number_alone_and_tempering_takes_over(monkeypatch: pytest.MonkeyPatch) -> None:
    source = from_prior(GaussianNoise(SD**2), TRACKED)
    experiment = repeatable(source)
    first = replicated(experiment, source, seed=1, number=3)
    replicated(experiment, source, seed=1, number=0)
    assert same(replicated(experiment, source, seed=1, number=3), first)
    for seed, number in ((2, 3), (1, 4)):
        assert not same(replicated(experiment, source, seed=seed, number=number), first)
    monkeypatch.setattr(module, "followed", lambda *given: None)
    other = replicated(experiment, source, seed=1, number=3)
    assert (first.by, other.by) == ("importance", "smc")
    np.testing.assert_array_equal(other.truth, first.truth)
    assert np.abs((other.mean - first.mean) / first.sd).max() < 0.3
    assert np.abs(other.sd / first.sd - 1).max() < 0.25


@cache
def stored() -> Posterior:
    """The posterior of the real observation as weighted draws of the prior."""
    draws = SPACE.prior_quantiles(np.random.default_rng(9).random((30000, 2)))
    values = known(NOISE, TRACKED).plug_in(draws)
    log_prior, log_evidence = np.asarray(SPACE.log_prior(draws)), float(logsumexp(values) - np.log(30000))
    return Posterior(SPACE, draws, np.asarray(log_softmax(values)), values, log_prior, log_evidence)


def test_truths_from_the_posterior() -> None:
    """Planted: a noise variance 16 times too small."""
    source = posterior_source(known(NOISE, TRACKED), stored())
    found = repeated(source)
    assert least_p(found) > 1e-3
    prior = prior_source(source.knowledge, SPACE)
    before, after = (np.sqrt(np.diag(one.covariance)) for one in (prior, source))
    assert (after < 0.5 * before).all()
    assert (found.sd < 0.9 * after).all()  # the repeated observation adds to the real one
    spread = np.array([one.truth for one in found.replicates]).std(axis=0)
    assert (np.abs(spread / after - 1) < 0.5).all()
    assert not repeated(source, GaussianNoise(NOISE.variance / 16)).calibrated


def test_the_density_of_a_source_is_normalised_inside_the_prior() -> None:
    found = known(NOISE, TRACKED)
    u = (np.stack(np.meshgrid(np.arange(60), np.arange(60), indexing="ij"), axis=-1).reshape(-1, 2) + 0.5) / 60
    x, cell = SPACE.to_physical(u), np.prod(SPACE.high - SPACE.low) / 60**2
    for source, error in ((prior_source(found, SPACE), 1e-9), (posterior_source(found, stored()), 0.25)):
        mass = np.exp(source.log_density(x, found.surrogate.mean(x))).sum() * cell
        assert mass == pytest.approx(1.0, abs=error)
        some = np.array([[0.3, 0.0], [0.3, 0.5], [-1.0, 0.0], [0.2, -0.1]])
        assert source.inside(some).tolist() == [True, False, False, True]
    with pytest.raises(InvalidInput, match="disagree"):
        posterior_source(found, replace(stored(), log_likelihood=-20 * stored().log_likelihood))


def test_a_coarse_surrogate_is_noticed() -> None:
    source = from_prior(GaussianNoise(SD**2), TRACKED)
    good, found = field_quality(source), source.knowledge
    assert good.good
    assert good.median <= good.q95
    wider = tuple(replace(process, widening=1e16) for process in found.surrogate.processes)
    likelihood = replace(found.likelihood, surrogate=replace(found.surrogate, processes=wider))
    coarse = field_quality(replace(source, knowledge=replace(found, likelihood=likelihood)))
    assert not coarse.good
    assert coarse.hidden == good.hidden
    assert coarse.beyond > 0.5


def test_the_fit_shows_what_is_spread_over_seven_inputs() -> None:
    """Planted: variances that are half as large as they should be, which no single input shows in 20 replicates."""
    for narrow in (1.0, 0.5):
        random, made, one = np.random.default_rng(2), [], np.ones(7)
        for k in range(20):
            truth, draws = random.normal(size=7), np.sqrt(narrow) * random.normal(size=(500, 7))
            fit = float(np.mean((draws**2).sum(axis=1) > truth @ truth))
            ranks = weighted_ranks(draws, np.full(len(draws), 1 / len(draws)), truth)
            made.append(Replicate(k, truth, ranks, fit, 0 * one, one, one, 500.0, "importance"))
        found = CoverageFound(tuple("abcdefg"), tuple(made))
        assert all(band.inside for band in found.bands)
        assert found.calibrated is found.fit_band.inside is (narrow == 1.0)
        assert found.calibrated or "fit best" in found.verdict


def gaussians(shift: float = 0.0, width: float = 1.0, number: int = 200, *, fit: float = 1.0) -> CoverageFound:
    """Return what posteriors show whose z-scores are Gaussian, in evenly spaced quantiles.

    `fit` is the power of the ranks of the log-likelihood.
    """
    random = np.random.default_rng(3)
    columns = [random.permutation((np.arange(number) + 0.5) / number) for _ in range(2)]
    z = np.stack([norm.ppf(columns[0]), shift + width * norm.ppf(columns[1])], axis=1)
    one, half = np.ones(2), np.full(2, 0.5)
    fits = random.permutation((np.arange(number) + 0.5) / number) ** fit
    made = [
        Replicate(k, row, np.asarray(norm.cdf(row)), rank, 0 * one, one, half, 500.0, "importance")
        for k, (row, rank) in enumerate(zip(z, fits, strict=True))
    ]
    return CoverageFound(("E", "nu"), tuple(made))


def test_the_verdict_in_words() -> None:
    too_narrow, too_wide, shifted = (f"The posterior is {how}: " for how in ("too narrow", "too wide", "shifted"))
    rows: list[tuple[dict[str, float], str]] = [
        ({}, "The posterior is calibrated: all ranks stay inside the 95 % band."),
        ({"fit": 3.0}, too_narrow + "the truth is among the 90 % of its draws that fit best in 53.5 % of"),
        ({"fit": 0.3}, too_wide + "the truth is among the 90 % of its draws that fit best in 100 % of"),
        ({"width": 1.8}, too_narrow + "90 % intervals of nu contain the truth in 6"),
        ({"width": 0.5}, too_wide + "90 % intervals of nu contain the truth in 100 % of"),
        ({"shift": 0.6}, shifted + "means of nu are 0.6 standard deviations too low."),
        ({"shift": -0.6}, shifted + "means of nu are 0.6 standard deviations too high."),
    ]
    for wrong, words in rows:
        found = gaussians(**wrong)
        assert found.verdict.startswith(words)
        assert found.calibrated is (not wrong)
        assert len(found.remarks) == 1
        assert found.bands[0].inside
        assert found.verdict in repr(found)
        np.testing.assert_allclose(found.of_limit, 2.0)
    (few,) = gaussians(number=40).remarks
    assert "40 replicates show only gross errors; make at least 100" in few
