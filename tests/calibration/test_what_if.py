"""Posteriors under other assumptions against quadrature of the true model, with planted bugs that must show."""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp
from tests.calibration.arches import SD, SPACE, TRUTH, T, arch, knowledge, seen

from strandline.calibration import what_if as module
from strandline.calibration.alternative import Alternative, Present, present
from strandline.calibration.usual_alternatives import (
    _common_errors,
    facts_of,
    other_priors,
    prior_in_words,
    scaled_noise,
    usual_alternatives,
    with_prior,
)
from strandline.calibration.what_if import Answer, answered
from strandline.design import sobol
from strandline.design.active import Knowledge
from strandline.discrepancy import ClosestPoint, Discrepancy, NormalOffset, TrackedPoints
from strandline.errors import InvalidInput
from strandline.interface import GaussianNoise, Observation, PointErrors, UnknownErrors
from strandline.likelihood import InterfaceLikelihood
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.priors import LogNormal, LogUniform, Normal, Prior, ScaledBeta, Uniform

INPUTS = with_prior(SPACE, {"height": Normal(0.32, 0.03), "lean": ScaledBeta(2.0, 3.0, -0.1, 0.2)})
INPUTS = ParameterSpace((INPUTS["height"], replace(INPUTS["lean"], nuisance=True)))
NOISE = GaussianNoise((25 * SD) ** 2)
TRACKED = TrackedPoints()
DRAWS = 4096
NODES = 160
FAR = 4.0
"""Standard errors that an estimate may be off."""


def observed(noise: Any = NOISE) -> dict[str, Observation]:
    conditions = {"1": 1.0, "1.5": 1.5}
    return {name: Observation(seen(PointErrors(SD), factor), noise, name) for name, factor in conditions.items()}


@cache
def known(measure: Discrepancy = TRACKED) -> Knowledge:
    return knowledge(measure, observed())


def arches(x: Float[np.ndarray, "point dim"], factor: float) -> Float[np.ndarray, "point node xy"]:
    """Return the nodes of many arches."""
    height, lean = 0.3 + factor * (x[:, :1] - 0.3), factor * x[:, 1:]
    y = 4 * height * T * (1 - T) + 0.5 * height**2 * np.sin(2 * np.pi * T)
    return np.stack([T + lean * (1 + height) * np.sin(np.pi * T), y], axis=2)


def true_log_likelihood(
    x: Float[np.ndarray, "point dim"], observations: tuple[Observation, ...], measure: Discrepancy = TRACKED
) -> Float[np.ndarray, " point"]:
    """Return log L by the true model: of tracked points at once, of another measure point by point."""
    if measure is TRACKED:
        off = [arches(x, float(o.condition)) - o.interface.points for o in observations]
        return -0.5 * sum((d**2).sum(axis=(1, 2)) / o.noise.scale for d, o in zip(off, observations, strict=True))
    likelihood = InterfaceLikelihood(observations, measure)
    return np.array([likelihood({o.condition: arch(row, float(o.condition)) for o in observations}) for row in x])


@cache
def now() -> Present:
    """The posterior as weighted draws of the prior, by the true model."""
    draws = INPUTS.prior_quantiles(sobol(DRAWS, 2, scramble=1))
    values = true_log_likelihood(draws, tuple(observed().values()))
    log_evidence = float(logsumexp(values)) - math.log(DRAWS)
    log_prior = np.asarray(INPUTS.log_prior(draws))
    posterior = Posterior(INPUTS, draws, log_softmax(values), values, log_prior, log_evidence)
    return present(posterior, known())


class Exact:
    """Evidence and moments by Gauss-Legendre quadrature of the true model in the box."""

    def __init__(self, space: ParameterSpace, observations: tuple[Observation, ...], measure: Discrepancy) -> None:
        nodes, weights = np.polynomial.legendre.leggauss(NODES if measure is TRACKED else NODES // 5)
        grid = np.stack(np.meshgrid(nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 2)
        x = space.low + 0.5 * (grid + 1) * (space.high - space.low)
        log_w = np.log(np.outer(weights, weights).ravel() * np.prod(0.5 * (space.high - space.low)))
        total = log_w + true_log_likelihood(x, observations, measure) + np.asarray(space.log_prior(x))
        self.log_evidence = float(logsumexp(total))
        p = np.exp(total - self.log_evidence)
        self.mean = p @ x
        self.sd = np.sqrt(p @ (x - self.mean) ** 2)


def alternatives() -> dict[str, tuple[Alternative, tuple[Observation, ...], Discrepancy]]:
    """Return alternatives with the observations and the measure that make them exact."""
    here, likelihood = tuple(observed().values()), known().likelihood

    def noisy(factor: float) -> tuple[Alternative, tuple[Observation, ...], Discrepancy]:
        noise = GaussianNoise(factor**2 * NOISE.variance)
        some = tuple(Observation(o.interface, noise, o.condition) for o in here)
        other = replace(likelihood, observations=some)
        return Alternative("noise", "noise", "", INPUTS, other, by_prior_alone=False), some, TRACKED

    def prior(**priors: Prior) -> tuple[Alternative, tuple[Observation, ...], Discrepancy]:
        return Alternative("prior", "prior", "", with_prior(INPUTS, priors)), here, TRACKED

    closest = ClosestPoint(direction="to_observed")
    measure = replace(likelihood, discrepancy=closest)
    fewer = replace(likelihood, observations=here[:1])
    return {
        "narrow prior": prior(height=Normal(0.28, 0.02), lean=ScaledBeta(6.0, 5.0, -0.1, 0.2)),
        "flat priors": prior(height=Uniform(0.2, 0.4), lean=Uniform(-0.1, 0.2)),
        "far prior": prior(height=Normal(0.25, 0.005)),
        "sharper": noisy(0.5),
        "much sharper": noisy(0.2),
        "wider": noisy(2.0),
        "measure": (Alternative("m", "measure", "", INPUTS, measure, by_prior_alone=False), here, closest),
        "fewer": (Alternative("f", "without", "", INPUTS, fewer, by_prior_alone=False), here[:1], TRACKED),
    }


BY = {"far prior": "importance", "much sharper": "importance"}


@cache
def exact(name: str) -> Exact:
    alternative, observations, measure = alternatives()[name]
    return Exact(alternative.space, observations, measure)


def distance(answer: Answer, truth: Exact, *, evidence: bool) -> float:
    """Return the largest distance from the truth, in standard errors, of means, standard deviations and evidence."""
    draws = answer.draws
    assert draws is not None
    of_mean = np.sqrt(np.sum(draws.weights[:, None] ** 2 * (draws.draws - draws.mean) ** 2, axis=0))
    of_sd = truth.sd / math.sqrt(2 * answer.effective)
    far = [np.abs(draws.mean - truth.mean) / of_mean, np.abs(draws.sd - truth.sd) / of_sd]
    if evidence:
        assert answer.log_evidence_change is not None
        change = truth.log_evidence - exact_now().log_evidence
        far.append(np.abs([answer.log_evidence_change - change]) * math.sqrt(answer.effective))
    return float(np.concatenate(far).max())


@cache
def exact_now() -> Exact:
    return Exact(INPUTS, tuple(observed().values()), TRACKED)


@pytest.mark.parametrize("name", alternatives())
def test_an_answer_is_that_of_the_true_model(name: str) -> None:
    alternative = alternatives()[name][0]
    found = answered(now(), alternative, seed=1)
    assert found.by == BY.get(name, "reweighting")
    assert (found.log_evidence_change is not None) == alternative.by_prior_alone
    assert distance(found, exact(name), evidence=alternative.by_prior_alone) < FAR


def twice(log_ratios: Any) -> Any:
    from strandline.posterior.pareto_smoothing import pareto_smoothed

    return pareto_smoothed(2 * log_ratios)


def forgets_the_old_prior(patch: pytest.MonkeyPatch) -> Present:
    return replace(now(), log_prior=np.zeros(len(now().draws)))


def squares_the_weights(patch: pytest.MonkeyPatch) -> Present:
    patch.setattr(module, "pareto_smoothed", twice)
    return now()


def forgets_the_old_likelihood(patch: pytest.MonkeyPatch) -> Present:
    return replace(now(), log_likelihood=np.zeros(len(now().draws)))


def forgets_the_new_likelihood(patch: pytest.MonkeyPatch) -> Present:
    patch.setattr(module, "_with", lambda knowledge, alternative: knowledge)
    return now()


def counts_the_likelihood_twice(patch: pytest.MonkeyPatch) -> Present:
    patch.setattr(module, "_gained", lambda known, x, log_weights, plug_in: known.expected(x))
    return now()


PLANTED: dict[str, tuple[str, Callable[[pytest.MonkeyPatch], Present]]] = {
    "the old prior is forgotten": ("flat priors", forgets_the_old_prior),
    "weights are squared": ("narrow prior", squares_the_weights),
    "the old likelihood is forgotten": ("wider", forgets_the_old_likelihood),
    "the new likelihood is forgotten": ("wider", forgets_the_new_likelihood),
    "the likelihood counts twice": ("far prior", counts_the_likelihood_twice),
}


@pytest.mark.parametrize("bug", PLANTED)
def test_a_planted_bug_shows(bug: str, monkeypatch: pytest.MonkeyPatch) -> None:
    name, plant = PLANTED[bug]
    right = answered(now(), alternatives()[name][0], seed=1)
    assert distance(right, exact(name), evidence=False) < FAR
    wrong = answered(plant(monkeypatch), alternatives()[name][0], seed=1)
    assert distance(wrong, exact(name), evidence=False) > 2 * FAR


def test_a_fixed_input_is_known() -> None:
    """Against quadrature in the other input alone."""
    alternative = Alternative("known", "fix", "", INPUTS, fixed={"lean": 0.02})
    found = answered(now(), alternative, seed=1)
    x = np.linspace(0.2, 0.4, 801)
    points = np.stack([x, np.full(len(x), 0.02)], axis=1)
    values = true_log_likelihood(points, tuple(observed().values()))
    values += np.asarray(INPUTS["height"].truncated_prior.log_density(x))
    p = np.exp(log_softmax(values))
    mean = p @ x
    sd = np.sqrt(p @ (x - mean) ** 2)
    log_evidence = float(logsumexp(values)) + math.log(x[1] - x[0])
    assert found.draws is not None
    assert found.log_evidence_change is not None
    assert found.by == "importance"
    assert abs(found.draws.mean[0] - mean) < FAR * sd / math.sqrt(found.effective)
    assert abs(found.draws.sd[0] / sd - 1) < FAR / math.sqrt(2 * found.effective)
    assert abs(found.log_evidence_change - (log_evidence - exact_now().log_evidence)) < FAR / math.sqrt(found.effective)
    assert (found.draws.draws[:, 1] == 0.02).all()
    assert np.isnan(found.shift[1])
    assert np.isnan(found.sd_ratio[1])
    assert "lean" not in found.moved


def test_tempering_takes_over_where_importance_sampling_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "followed", lambda *given, **options: None)
    monkeypatch.setattr(module, "PARTICLES", 1000)
    found = answered(now(), alternatives()["far prior"][0], seed=1)
    assert found.by == "smc"
    truth = exact("far prior")
    assert found.draws is not None
    assert np.abs((found.draws.mean - truth.mean) / truth.sd).max() < 0.2
    assert np.abs(found.draws.sd / truth.sd - 1).max() < 0.15
    assert found.log_evidence_change == pytest.approx(truth.log_evidence - exact_now().log_evidence, abs=0.2)


def test_inputs_outside_the_old_prior_are_sampled_again() -> None:
    """Weights of draws cannot show what lies where there are none: the tail of the weights looks harmless."""
    narrow = with_prior(INPUTS, {"lean": Uniform(-0.1, 0.05)})
    draws = narrow.prior_quantiles(sobol(2048, 2, scramble=1))
    values = true_log_likelihood(draws, tuple(observed().values()))
    old = np.asarray(narrow.log_prior(draws))
    posterior = Posterior(narrow, draws, log_softmax(values), values, old, float(logsumexp(values)) - math.log(2048))
    wide = Alternative("wide", "prior", "", with_prior(INPUTS, {"lean": Uniform(-0.1, 0.2)}))
    found = answered(present(posterior, known()), wide, seed=1)
    assert found.by == "importance"
    truth = Exact(wide.space, tuple(observed().values()), TRACKED)
    assert distance(found, truth, evidence=False) < FAR
    alone = answered(present(posterior, None, why_not="no surrogate"), wide, seed=1)
    assert (alone.by, alone.why_not, alone.size) == (None, "no surrogate", 0.0)
    assert repr(alone) == "<Answer to wide: needs new runs>"


def test_without_a_surrogate_only_priors_are_answered() -> None:
    stored = replace(now(), knowledge=None, why_not="there is none")
    assert answered(stored, alternatives()["narrow prior"][0], seed=1).by == "reweighting"
    assert answered(stored, alternatives()["sharper"][0], seed=1).why_not == "there is none"
    assert {one.kind for one in usual_alternatives(stored, {})} == {"prior", "fix"}


def test_a_coarse_surrogate_gives_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    sharp = alternatives()["sharper"][0]
    right = module.quality_at
    monkeypatch.setattr(module, "quality_at", lambda *given: replace(right(*given), beyond=0.4))
    found = answered(now(), sharp, seed=1)
    assert (found.by, found.draws) == (None, None)
    assert found.why_not == "the surrogate of the interface is too coarse at 40 % of its draws"
    assert np.isnan(found.shift_error).all()
    monkeypatch.setattr(
        "strandline.calibration.alternative.quality_at", lambda *given: replace(right(*given), beyond=1.0)
    )
    posterior = Posterior(INPUTS, now().draws, now().log_weights, now().log_likelihood, now().log_prior, 0.0)
    without = present(posterior, known())
    assert without.knowledge is None
    assert without.why_not.startswith("the surrogate of the interface is too coarse at 100 %")
    assert re.search(r"draws: it errs by \S+ µm, and the local noise hides \S+ µm$", without.why_not)


def test_a_posterior_of_another_likelihood_is_not_compared() -> None:
    values = np.where(np.arange(DRAWS) == 7, 100.0, 0.0)
    off = Posterior(INPUTS, now().draws, np.full(DRAWS, -math.log(DRAWS)), values, now().log_prior, 0.0)
    strange = replace(off, log_likelihood=-300.0 * (np.arange(DRAWS) % 97))
    found = present(strange, known())
    assert found.knowledge is None
    assert "effective draws" in found.why_not


def test_errors_of_shifts_cover_their_scatter() -> None:
    """Over posteriors by other draws: of draws in common, and of two samples."""
    for name, bound in (("narrow prior", 1.6), ("much sharper", 1.6)):
        shifts, errors = [], []
        for seed in range(10):
            random = np.random.default_rng(seed)
            chosen = random.choice(DRAWS, 1500, p=now().weighted.weights)
            part = replace(
                now(),
                draws=now().draws[chosen],
                log_weights=np.full(1500, -math.log(1500)),
                log_likelihood=now().log_likelihood[chosen],
                log_prior=now().log_prior[chosen],
            )
            found = answered(part, alternatives()[name][0], seed=seed)
            shifts.append(found.shift)
            errors.append(found.shift_error)
        scatter = np.std(shifts, axis=0, ddof=1)
        assert (scatter < bound * np.mean(errors, axis=0)).all()
        assert (scatter > np.mean(errors, axis=0) / 2.5).all()


def test_what_moves() -> None:
    found = answered(now(), alternatives()["much sharper"][0], seed=1)
    assert found.moves
    assert found.size > 1
    assert repr(found).endswith("importance, moves>")
    same = answered(now(), Alternative("same", "prior", "", INPUTS), seed=1)
    assert same.moved == ()
    np.testing.assert_allclose(same.shift, 0, atol=2e-3)  # the smoothing of the largest weights
    np.testing.assert_allclose(same.sd_ratio, 1, atol=2e-3)
    np.testing.assert_allclose(same.shift_error, 0, atol=2e-3)
    assert same.log_evidence_change == pytest.approx(0, abs=1e-12)
    assert repr(now()).startswith("<Present posterior of height, lean: 4096 draws")


@pytest.mark.parametrize(
    ("prior", "narrower", "wider"),
    [
        (Uniform(2.0, 6.0), ScaledBeta(5.5, 5.5, 2.0, 6.0), None),
        (Normal(3.0, 0.7), Normal(3.0, 0.35), Normal(3.0, 1.4)),
        (LogNormal(1.0, 0.2), LogNormal(1.0, 0.1), LogNormal(1.0, 0.4)),
        (ScaledBeta(20.0, 30.0, 2.0, 6.0), ScaledBeta(81.2, 121.8, 2.0, 6.0), ScaledBeta(4.7, 7.05, 2.0, 6.0)),
        (ScaledBeta(2.6, 1.4, 2.0, 6.0), ScaledBeta(12.35, 6.65, 2.0, 6.0), None),
    ],
)
def test_widths_of_other_priors(prior: Prior, narrower: Prior, wider: Prior | None) -> None:
    found = dict(other_priors(Parameter("a", prior, box=(2.0, 6.0))))
    assert vars(found["half as wide"]) == pytest.approx(vars(narrower))
    assert type(found["half as wide"]) is type(narrower)
    if wider is None:
        assert "twice as wide" not in found
    else:
        assert vars(found["twice as wide"]) == pytest.approx(vars(wider))
    assert ("flat in its box" in found) == (prior != Uniform(2.0, 6.0))
    assert found["flat in its logarithm"] == LogUniform(2.0, 6.0)
    if not isinstance(prior, LogNormal):
        levels = (np.arange(20000) + 0.5) / 20000
        sds = [float(np.std(one.quantile(levels))) for one in (prior, narrower)]
        assert sds[1] / sds[0] == pytest.approx(0.5, abs=2e-3)


def test_priors_without_a_form_of_their_own() -> None:
    found = dict(other_priors(Parameter("a", LogUniform(1.0, math.e**2))))
    assert set(found) == {"half as wide", "flat in its box"}
    assert vars(found["half as wide"])["mu"] == pytest.approx(1.0)

    class Own(Normal):
        pass

    halved = dict(other_priors(Parameter("a", Own(0.0, 2.0), box=(-5.0, 5.0))))["half as wide"]
    assert isinstance(halved, Normal)
    assert prior_in_words(Normal(350.0, 50.0)) == "normal [350, 50]"
    assert prior_in_words(Own(1.0, 2.0)).startswith("test_priors")


def test_scaled_noise() -> None:
    assert scaled_noise(GaussianNoise(4.0), 0.5) == GaussianNoise(1.0)
    errors = PointErrors(0.01, 0.1, shift=0.02)
    assert scaled_noise(errors, 2.0) == PointErrors(0.02, 0.1, shift=0.02)
    assert scaled_noise(UnknownErrors(0.01, 0.1, model_error=True), 2.0) == UnknownErrors(0.02, 0.1, model_error=True)
    assert scaled_noise(UnknownErrors(), 2.0) is None


def test_the_usual_questions() -> None:
    found = {one.name: one for one in usual_alternatives(now(), {"tracked_points": TRACKED, "offset": NormalOffset()})}
    assert list(found) == [
        "prior of height half as wide",
        "prior of height twice as wide",
        "prior of height flat in its box",
        "prior of height flat in its logarithm",
        "prior of lean half as wide",
        "prior of lean flat in its box",
        "lean known to be 0.01572",
        "noise half as large",
        "noise twice as large",
        "measure offset",
        "without condition 1",
        "without condition 1.5",
    ]
    likelihood = found["noise half as large"].likelihood
    assert likelihood is not None
    assert facts_of(likelihood) == f"noise variance {NOISE.variance / 4:.4g}"
    assert found["lean known to be 0.01572"].fixed == {"lean": 0.01572}
    assert [one.about for one in found.values()][-1] == "condition 1.5"


def test_noise_that_is_inferred_is_asked_about_at_its_median() -> None:
    """With a model error, one alternative leaves it out."""
    observations = observed(UnknownErrors(sd=SD, length=0.02, model_error=True))
    mine = replace(now(), knowledge=knowledge(NormalOffset(), observations))
    found = {one.name: one for one in usual_alternatives(mine, {})}
    for one in _observations(found["noise twice as large"]):
        assert isinstance(one.noise, UnknownErrors)
        assert one.noise.model_error
        assert (one.noise.sd, one.noise.length) == (pytest.approx(2 * SD), pytest.approx(0.02))
    for one in _observations(found["no model error"]):
        assert isinstance(one.noise, PointErrors)
        assert (one.noise.sd, one.noise.length) == (pytest.approx(SD), pytest.approx(0.02))
    unknown = replace(now(), knowledge=knowledge(NormalOffset(), observed(UnknownErrors())))
    (twice_as_large,) = (one for one in usual_alternatives(unknown, {}) if one.name == "noise twice as large")
    (first, _) = (seen.noise for seen in _observations(twice_as_large))
    assert isinstance(first, PointErrors)
    assert 1.2 * SD < first.sd < 3.5 * SD


def _observations(one: Alternative) -> tuple[Observation, ...]:
    assert one.likelihood is not None
    return one.likelihood.observations


def test_some_calibrated_input_must_be_left() -> None:
    with pytest.raises(InvalidInput, match="at least one calibrated input left"):
        Alternative("all", "fix", "", INPUTS, fixed={"height": TRUTH[0]})


def test_each_error_that_all_points_share_is_halved_and_doubled() -> None:
    errors = PointErrors(0.002, 0.01, shift=0.01, scale=0.02)
    likelihood = known().likelihood
    seen = tuple(Observation(one.interface, errors, one.condition) for one in likelihood.observations)
    found = {one.name: one for one in _common_errors(replace(likelihood, observations=seen), INPUTS)}
    assert set(found) == {f"unknown {name} {by} as large" for name in ("shift", "scale") for by in ("half", "twice")}
    for name, stated in (("shift", 0.01), ("scale", 0.02)):
        for words, factor in (("half", 0.5), ("twice", 2.0)):
            other = found[f"unknown {name} {words} as large"].likelihood
            assert other is not None
            assert other.observations[0].noise == replace(errors, **{name: factor * stated})
    assert not list(_common_errors(likelihood, INPUTS))


def test_facts_of_different_noise() -> None:
    here: Mapping[str, Observation] = observed()
    some = (here["1"], replace(here["1.5"], noise=GaussianNoise(2.0)))
    words = facts_of(replace(known().likelihood, observations=some))
    assert words == f"1: noise variance {NOISE.variance:.4g}; 1.5: noise variance 2"
    some = (replace(here["1"], noise=PointErrors(0.003, 0.02, shift=0.045, rotation=1.2, scale=0.01)),)
    words = facts_of(replace(known().likelihood, observations=some))
    assert words == "point sd 3 µm, correlation length 20 µm, shift sd 45 µm, rotation sd 1.2°, scale sd 1 %"
