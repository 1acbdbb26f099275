"""Posteriors under other assumptions against quadrature of the true model, with planted bugs that must show."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.special import log_softmax, logsumexp
from tests.unit.calibration.arches import SD, SPACE, TRACKED, TRUTH, Exact, knowledge, seen, true_log_likelihood

from strandline.calibration import what_if as module
from strandline.calibration.alternative import Alternative, Present, present
from strandline.calibration.usual_alternatives import usual_alternatives, with_prior
from strandline.calibration.what_if import Answer, answered
from strandline.design import sobol
from strandline.design.active import Knowledge
from strandline.discrepancy import ClosestPoint, Discrepancy
from strandline.errors import InvalidInput
from strandline.interface import GaussianNoise, Observation, PointErrors
from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior
from strandline.posterior.pareto_smoothing import pareto_smoothed
from strandline.priors import Normal, Prior, ScaledBeta, Uniform

INPUTS = with_prior(SPACE, {"height": Normal(0.32, 0.03), "lean": ScaledBeta(2.0, 3.0, -0.1, 0.2)})
INPUTS = ParameterSpace((INPUTS["height"], replace(INPUTS["lean"], nuisance=True)))
NOISE = GaussianNoise((25 * SD) ** 2)
DRAWS = 4096
FAR = 4.0
"""Standard errors that an estimate may be off."""
Case = tuple[Alternative, tuple[Observation, ...], Discrepancy]


def observed(noise: Any = NOISE) -> dict[str, Observation]:
    conditions = {"1": 1.0, "1.5": 1.5}
    return {name: Observation(seen(PointErrors(SD), factor), noise, name) for name, factor in conditions.items()}


HERE = tuple(observed().values())


@cache
def known() -> Knowledge:
    return knowledge(TRACKED, observed())


def weighted_prior(space: ParameterSpace, number: int) -> Posterior:
    """Return the posterior as weighted draws of the prior, by the true model."""
    draws = space.prior_quantiles(sobol(number, 2, scramble=1))
    values, log_prior = true_log_likelihood(draws, HERE), np.asarray(space.log_prior(draws))
    log_evidence = float(logsumexp(values)) - math.log(number)
    return Posterior(space, draws, log_softmax(values), values, log_prior, log_evidence)


@cache
def now() -> Present:
    return present(weighted_prior(INPUTS, DRAWS), known())


@cache
def exact_now() -> Exact:
    return Exact(INPUTS, HERE)


def prior(**priors: Prior) -> Case:
    return Alternative("prior", "prior", "", with_prior(INPUTS, priors)), HERE, TRACKED


def noisy(factor: float) -> Case:
    some = tuple(replace(o, noise=GaussianNoise(factor**2 * NOISE.variance)) for o in HERE)
    other = replace(known().likelihood, observations=some)
    return Alternative("noise", "noise", "", INPUTS, other, by_prior_alone=False), some, TRACKED


def by_measure() -> Case:
    closest = ClosestPoint(direction="to_observed")
    other = replace(known().likelihood, discrepancy=closest)
    return Alternative("m", "measure", "", INPUTS, other, by_prior_alone=False), HERE, closest


def fewer() -> Case:
    other = replace(known().likelihood, observations=HERE[:1])
    return Alternative("f", "without", "", INPUTS, other, by_prior_alone=False), HERE[:1], TRACKED


CASES: dict[str, Callable[[], Case]] = {
    "narrow prior": lambda: prior(height=Normal(0.28, 0.02), lean=ScaledBeta(6.0, 5.0, -0.1, 0.2)),
    "flat priors": lambda: prior(height=Uniform(0.2, 0.4), lean=Uniform(-0.1, 0.2)),
    "far prior": lambda: prior(height=Normal(0.25, 0.005)),
    "much sharper": lambda: noisy(0.2),
    "wider": lambda: noisy(2.0),
    "measure": by_measure,
    "fewer": fewer,
}
"""Alternatives with the observations and the measure that make them exact."""


def distance(answer: Answer, truth: Exact, *, evidence: bool = False) -> float:
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


def forgets_the_old_prior(patch: pytest.MonkeyPatch) -> Present:
    return replace(now(), log_prior=np.zeros(len(now().draws)))


def squares_the_weights(patch: pytest.MonkeyPatch) -> Present:
    patch.setattr(module, "pareto_smoothed", lambda log_ratios: pareto_smoothed(2 * log_ratios))
    return now()


def forgets_the_old_likelihood(patch: pytest.MonkeyPatch) -> Present:
    return replace(now(), log_likelihood=np.zeros(len(now().draws)))


def forgets_the_new_likelihood(patch: pytest.MonkeyPatch) -> Present:
    patch.setattr(module, "_with", lambda knowledge, alternative: knowledge)
    return now()


def counts_the_likelihood_twice(patch: pytest.MonkeyPatch) -> Present:
    patch.setattr(module, "_gained", lambda known, x, log_weights, plug_in: known.expected(x))
    return now()


PLANTED = {
    "flat priors": [forgets_the_old_prior],
    "narrow prior": [squares_the_weights],
    "wider": [forgets_the_old_likelihood, forgets_the_new_likelihood],
    "far prior": [counts_the_likelihood_twice],
}


def test_an_answer_is_that_of_the_true_model_and_a_planted_bug_shows() -> None:
    for name, case in CASES.items():
        alternative, observations, measure = case()
        truth = Exact(alternative.space, observations, measure)
        found = answered(now(), alternative, seed=1)
        assert found.by == ("importance" if name in ("far prior", "much sharper") else "reweighting"), name
        assert (found.log_evidence_change is not None) == alternative.by_prior_alone
        assert distance(found, truth, evidence=alternative.by_prior_alone) < FAR, name
        for plant in PLANTED.get(name, []):
            with pytest.MonkeyPatch.context() as patch:
                assert distance(answered(plant(patch), alternative, seed=1), truth) > 2 * FAR, plant


def test_a_fixed_input_is_known() -> None:
    """Against quadrature in the other input alone."""
    alternative = Alternative("known", "fix", "", INPUTS, fixed={"lean": 0.02})
    found = answered(now(), alternative, seed=1)
    x = np.linspace(0.2, 0.4, 801)
    values = true_log_likelihood(np.stack([x, np.full(len(x), 0.02)], axis=1), HERE)
    values += np.asarray(INPUTS["height"].truncated_prior.log_density(x))
    p = np.exp(log_softmax(values))
    mean = p @ x
    sd = np.sqrt(p @ (x - mean) ** 2)
    change = float(logsumexp(values)) + math.log(x[1] - x[0]) - exact_now().log_evidence
    assert found.draws is not None
    assert found.log_evidence_change is not None
    assert found.by == "importance"
    assert abs(found.draws.mean[0] - mean) < FAR * sd / math.sqrt(found.effective)
    assert abs(found.draws.sd[0] / sd - 1) < FAR / math.sqrt(2 * found.effective)
    assert abs(found.log_evidence_change - change) < FAR / math.sqrt(found.effective)
    assert (found.draws.draws[:, 1] == 0.02).all()
    assert np.isnan(found.shift[1])
    assert np.isnan(found.sd_ratio[1])
    assert "lean" not in found.moved
    with pytest.raises(InvalidInput, match="at least one calibrated input left"):
        Alternative("all", "fix", "", INPUTS, fixed={"height": TRUTH[0]})


def test_tempering_takes_over_where_importance_sampling_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "followed", lambda *given, **options: None)
    alternative, observations, _ = CASES["far prior"]()
    found, truth = answered(now(), alternative, seed=1), Exact(alternative.space, observations)
    assert found.by == "smc"
    assert found.draws is not None
    assert np.abs((found.draws.mean - truth.mean) / truth.sd).max() < 0.2
    assert np.abs(found.draws.sd / truth.sd - 1).max() < 0.15
    assert found.log_evidence_change == pytest.approx(truth.log_evidence - exact_now().log_evidence, abs=0.2)


def test_inputs_outside_the_old_prior_are_sampled_again() -> None:
    """Weights of draws cannot show what lies where there are none: the tail of the weights looks harmless."""
    posterior = weighted_prior(with_prior(INPUTS, {"lean": Uniform(-0.1, 0.05)}), 2048)
    wide = Alternative("wide", "prior", "", with_prior(INPUTS, {"lean": Uniform(-0.1, 0.2)}))
    found = answered(present(posterior, known()), wide, seed=1)
    assert found.by == "importance"
    assert distance(found, Exact(wide.space, HERE)) < FAR
    alone = answered(present(posterior, None, why_not="no surrogate"), wide, seed=1)
    assert (alone.by, alone.why_not, alone.size) == (None, "no surrogate", 0.0)
    assert repr(alone) == "<Answer to wide: needs new runs>"


def test_without_a_surrogate_only_priors_are_answered() -> None:
    stored = replace(now(), knowledge=None, why_not="there is none")
    assert answered(stored, CASES["narrow prior"]()[0], seed=1).by == "reweighting"
    assert answered(stored, CASES["wider"]()[0], seed=1).why_not == "there is none"
    assert {one.kind for one in usual_alternatives(stored, {})} == {"prior", "fix"}


def test_a_surrogate_that_is_too_coarse_or_of_another_likelihood_gives_no_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    right = module.quality_at
    monkeypatch.setattr(module, "quality_at", lambda *given: replace(right(*given), beyond=0.4))
    found = answered(now(), CASES["wider"]()[0], seed=1)
    assert (found.by, found.draws) == (None, None)
    assert found.why_not == "the surrogate of the interface is too coarse at 40 % of its draws"
    assert np.isnan(found.shift_error).all()
    posterior = Posterior(INPUTS, now().draws, now().log_weights, now().log_likelihood, now().log_prior, 0.0)
    strange = replace(posterior, log_likelihood=-300.0 * (np.arange(DRAWS) % 97))
    without = present(strange, known())
    assert without.knowledge is None
    assert "effective draws" in without.why_not
    monkeypatch.setattr(
        "strandline.calibration.alternative.quality_at", lambda *given: replace(right(*given), beyond=1.0)
    )
    without = present(posterior, known())
    assert without.knowledge is None
    assert without.why_not.startswith("the surrogate of the interface is too coarse at 100 %")
    assert re.search(r"draws: it errs by \S+ µm, and the local noise hides \S+ µm$", without.why_not)


def test_errors_of_shifts_cover_their_scatter() -> None:
    """Over posteriors by other draws: of draws in common, and of two samples."""
    for name in ("narrow prior", "much sharper"):
        alternative, found = CASES[name]()[0], []
        for seed in range(8):
            chosen = np.random.default_rng(seed).choice(DRAWS, 1500, p=now().weighted.weights)
            parts = {one: getattr(now(), one)[chosen] for one in ("draws", "log_likelihood", "log_prior")}
            part = replace(now(), **parts, log_weights=np.full(1500, -math.log(1500)))
            found.append(answered(part, alternative, seed=seed))
        scatter = np.std([one.shift for one in found], axis=0, ddof=1)
        stated = np.mean([one.shift_error for one in found], axis=0)
        assert (scatter < 1.7 * stated).all()
        assert (scatter > stated / 2.8).all()


def test_what_moves() -> None:
    found = answered(now(), CASES["much sharper"]()[0], seed=1)
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
