"""Posteriors under other assumptions against quadrature of the true model, planted bugs, and the usual questions."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import log_softmax, logsumexp
from tests.unit.calibration.arches import SD, SPACE, TRACKED, Exact, knowledge, seen, true_log_likelihood

from strandline.calibration import usual_alternatives as questions
from strandline.calibration import what_if as module
from strandline.calibration.usual_alternatives import facts_of, other_priors, scaled_noise, with_prior
from strandline.calibration.what_if import Alternative, baseline, reweight_or_resample
from strandline.design import sobol
from strandline.discrepancy import ClosestPoint, NormalOffset
from strandline.interface import GaussianNoise, Observation, PointErrors, UnknownErrors
from strandline.parameters import LogNormal, LogUniform, Normal, Parameter, ParameterSpace, ScaledBeta, Uniform
from strandline.posterior import Posterior
from strandline.posterior.importance import pareto_smoothed

INPUTS = with_prior(SPACE, {"height": Normal(0.32, 0.03), "lean": ScaledBeta(2.0, 3.0, -0.1, 0.2)})
INPUTS = ParameterSpace((INPUTS["height"], replace(INPUTS["lean"], nuisance=True)))
NOISE = GaussianNoise((25 * SD) ** 2)
DRAWS = 4096
FAR = 4.0
"""Standard errors that an estimate may be off."""


def observed(noise=NOISE):
    return {name: Observation(seen(PointErrors(SD), float(name)), noise, name) for name in ("1", "1.5")}


HERE = tuple(observed().values())


@cache
def known():
    return knowledge(TRACKED, observed())


def weighted_prior(space, number):
    """Return the posterior as weighted draws of the prior, by the true model."""
    draws = space.prior_quantiles(sobol(number, 2, scramble=1))
    values, log_prior = true_log_likelihood(draws, HERE), np.asarray(space.log_prior(draws))
    log_evidence = float(logsumexp(values)) - math.log(number)
    return Posterior(space, draws, log_softmax(values), values, log_prior, log_evidence)


@cache
def now():
    return baseline(weighted_prior(INPUTS, DRAWS), known())


@cache
def exact_now():
    return Exact(INPUTS, HERE)


def asked(mine, measures=None):
    return {one.name: one for one in questions.usual_alternatives(mine, measures or {})}


def prior(**priors):
    return Alternative("prior", "prior", "", with_prior(INPUTS, priors)), HERE, TRACKED


def other(observations=HERE, measure=TRACKED):
    """Return an alternative by another likelihood, with what makes it exact."""
    likelihood = replace(known().likelihood, observations=observations, discrepancy=measure)
    return Alternative("other", "noise", "", INPUTS, likelihood, by_prior_alone=False), observations, measure


def noisy(factor):
    return other(tuple(replace(o, noise=GaussianNoise(factor**2 * NOISE.variance)) for o in HERE))


CASES = {
    "narrow prior": lambda: prior(height=Normal(0.28, 0.02), lean=ScaledBeta(6.0, 5.0, -0.1, 0.2)),
    "flat priors": lambda: prior(height=Uniform(0.2, 0.4), lean=Uniform(-0.1, 0.2)),
    "far prior": lambda: prior(height=Normal(0.25, 0.005)),
    "much sharper": lambda: noisy(0.2),
    "wider": lambda: noisy(2.0),
    "measure": lambda: other(measure=ClosestPoint(direction="to_observed")),
    "fewer": lambda: other(HERE[:1]),
}
"""Alternatives with the observations and the measure that make them exact."""


def distance(answer, truth, *, evidence=False):
    """Return the largest distance from the truth, in standard errors, of means, standard deviations and evidence."""
    draws = answer.draws
    of_mean = np.sqrt(np.sum(draws.weights[:, None] ** 2 * (draws.draws - draws.mean) ** 2, axis=0))
    of_sd = truth.sd / math.sqrt(2 * answer.effective)
    far = [np.abs(draws.mean - truth.mean) / of_mean, np.abs(draws.sd - truth.sd) / of_sd]
    if evidence:
        change = truth.log_evidence - exact_now().log_evidence
        far.append(np.abs([answer.log_evidence_change - change]) * math.sqrt(answer.effective))
    return float(np.concatenate(far).max())


PLANTED = {
    "flat priors": [("log_prior", np.zeros(DRAWS))],
    "narrow prior": [("pareto_smoothed", lambda log_ratios: pareto_smoothed(2 * log_ratios))],
    "wider": [("log_likelihood", np.zeros(DRAWS)), ("_with", lambda knowledge, alternative: knowledge)],
    "far prior": [("_gained", lambda known, x, log_weights, plug_in: known.expected(x))],
}
"""What of the posterior is forgotten or which function changed: the old prior, squared weights, the old likelihood, the
new one; the likelihood counted twice."""


def test_an_answer_is_that_of_the_true_model_and_a_planted_bug_shows():
    for name, case in CASES.items():
        alternative, observations, measure = case()
        truth = Exact(alternative.space, observations, measure)
        found = reweight_or_resample(now(), alternative, seed=1)
        assert found.by == ("importance" if name in ("far prior", "much sharper") else "reweighting"), name
        assert (found.log_evidence_change is not None) == alternative.by_prior_alone
        assert distance(found, truth, evidence=alternative.by_prior_alone) < FAR, name
        for what, change in PLANTED.get(name, []):
            with pytest.MonkeyPatch.context() as patch:
                if callable(change):
                    patch.setattr(module, what, change)
                start = now() if callable(change) else replace(now(), **{what: change})
                assert distance(reweight_or_resample(start, alternative, seed=1), truth) > 2 * FAR, what


def test_widths_of_wider_posteriors_are_right_though_the_draws_are_narrower(monkeypatch):
    """Planted: k̂ alone decides, which passes draws of half the width."""
    alternative, observations, measure = noisy(2.0)
    truth, present = Exact(alternative.space, observations, measure), weighted_prior(INPUTS, 4 * DRAWS)

    def off():
        found = []
        for seed in range(6):
            draws = np.random.default_rng(seed).choice(len(present.weights), 1000, p=present.weights)
            same = replace(
                present,
                draws=present.draws[draws],
                log_weights=np.full(1000, -math.log(1000)),
                log_likelihood=present.log_likelihood[draws],
                log_prior=present.log_prior[draws],
            )
            answer = reweight_or_resample(baseline(same, known()), alternative, seed=seed)
            found.append(answer.draws.sd / truth.sd - 1)
        return np.max(np.abs(np.mean(found, axis=0)))

    assert off() < 0.05
    monkeypatch.setattr(module, "WIDEST", math.inf)
    assert off() > 0.05


def test_a_fixed_input_is_known():
    """Against quadrature in the other input alone."""
    alternative = Alternative("known", "fix", "", INPUTS, fixed={"lean": 0.02})
    found = reweight_or_resample(now(), alternative, seed=1)
    x = np.linspace(0.2, 0.4, 801)
    values = true_log_likelihood(np.stack([x, np.full(len(x), 0.02)], axis=1), HERE)
    values += np.asarray(INPUTS["height"].truncated_prior.log_density(x))
    p = np.exp(log_softmax(values))
    mean = p @ x
    sd = np.sqrt(p @ (x - mean) ** 2)
    change = float(logsumexp(values)) + math.log(x[1] - x[0]) - exact_now().log_evidence
    assert found.by == "importance"
    assert abs(found.draws.mean[0] - mean) < FAR * sd / math.sqrt(found.effective)
    assert abs(found.draws.sd[0] / sd - 1) < FAR / math.sqrt(2 * found.effective)
    assert abs(found.log_evidence_change - change) < FAR / math.sqrt(found.effective)
    assert (found.draws.draws[:, 1] == 0.02).all()


def test_inputs_outside_the_old_prior_are_sampled_again():
    """Weights of draws cannot show what lies where there are none: the tail of the weights looks harmless."""
    posterior = weighted_prior(with_prior(INPUTS, {"lean": Uniform(-0.1, 0.05)}), 2048)
    wide = Alternative("wide", "prior", "", with_prior(INPUTS, {"lean": Uniform(-0.1, 0.2)}))
    found = reweight_or_resample(baseline(posterior, known()), wide, seed=1)
    assert found.by == "importance"
    assert distance(found, Exact(wide.space, HERE)) < FAR


def test_without_a_surrogate_or_with_a_coarse_one_or_of_another_likelihood_only_priors_are_answered(monkeypatch):
    stored = replace(now(), knowledge=None, why_not="there is none")
    assert reweight_or_resample(stored, CASES["narrow prior"]()[0], seed=1).by == "reweighting"
    assert reweight_or_resample(stored, CASES["wider"]()[0], seed=1).why_not == "there is none"
    right = module.quality_at
    monkeypatch.setattr(module, "quality_at", lambda *given: replace(right(*given), beyond=0.4))
    found = reweight_or_resample(now(), CASES["wider"]()[0], seed=1)
    assert found.draws is None
    assert found.why_not == "the surrogate of the interface is too coarse at 40 % of its draws"
    another = -300.0 * (np.arange(DRAWS) % 97)
    without = baseline(Posterior(INPUTS, now().draws, now().log_weights, another, now().log_prior, 0.0), known())
    assert without.knowledge is None
    assert "effective draws" in without.why_not


def test_errors_of_shifts_cover_their_scatter_and_what_does_not_change_does_not_move():
    """Over posteriors by other draws: of draws in common, and of two samples."""
    for name in ("narrow prior", "much sharper"):
        alternative, found = CASES[name]()[0], []
        for seed in range(8):
            chosen = np.random.default_rng(seed).choice(DRAWS, 1500, p=now().weighted.weights)
            parts = {one: getattr(now(), one)[chosen] for one in ("draws", "log_likelihood", "log_prior")}
            part = replace(now(), **parts, log_weights=np.full(1500, -math.log(1500)))
            found.append(reweight_or_resample(part, alternative, seed=seed))
        scatter = np.std([one.shift for one in found], axis=0, ddof=1)
        stated = np.mean([one.shift_error for one in found], axis=0)
        assert (scatter < 1.7 * stated).all()
        assert (scatter > stated / 2.8).all()
    same = reweight_or_resample(now(), Alternative("same", "prior", "", INPUTS), seed=1)
    assert same.moved == ()
    np.testing.assert_allclose([*same.shift, *same.shift_error], 0, atol=2e-3)  # smoothing of the largest weights


def test_widths_of_other_priors_and_scaled_noise():
    levels, flat = (np.arange(20000) + 0.5) / 20000, Uniform(2.0, 6.0)
    for prior in (flat, Normal(4.0, 0.3), ScaledBeta(20.0, 30.0, 2.0, 6.0), ScaledBeta(2.6, 1.4, 2.0, 6.0)):
        found = dict(other_priors(Parameter("a", prior, box=(2.0, 6.0))))
        own, half = (one.quantile(levels) for one in (prior, found["half as wide"]))
        assert half.mean() == pytest.approx(own.mean(), rel=1e-3)
        assert half.std() == pytest.approx(0.5 * own.std(), rel=4e-3)
        assert ("flat in its box" in found) == (prior != flat)
        assert found["flat in its logarithm"] == LogUniform(2.0, 6.0)
        wider = found.get("twice as wide")
        assert wider is None or np.std(wider.quantile(levels)) == pytest.approx(2 * own.std(), rel=4e-3)
        assert (wider is None) == (own.std() > 0.5), "it would not fit in the box"
    found = dict(other_priors(Parameter("a", LogNormal(1.0, 0.2), box=(2.0, 6.0))))
    assert vars(found["half as wide"]) == pytest.approx(vars(LogNormal(1.0, 0.1)))
    assert scaled_noise(PointErrors(0.01, 0.1, shift=0.02), 2.0) == PointErrors(0.02, 0.1, shift=0.02)
    assert scaled_noise(UnknownErrors(), 2.0) is None


def inferred(noise):
    return asked(replace(now(), knowledge=knowledge(NormalOffset(), observed(noise))))


def test_inferred_noise_is_asked_about_at_its_median_and_each_shared_error_is_halved_and_doubled():
    """With a model error, one alternative leaves it out."""
    found = inferred(UnknownErrors(sd=SD, length=0.02, model_error=True))
    for name, factor, kind in (("noise twice as large", 2, UnknownErrors), ("no model error", 1, PointErrors)):
        for one in found[name].likelihood.observations:
            assert isinstance(one.noise, kind)
            assert (one.noise.sd, one.noise.length) == (pytest.approx(factor * SD), pytest.approx(0.02))
    first, _ = inferred(UnknownErrors())["noise twice as large"].likelihood.observations
    assert isinstance(first.noise, PointErrors)
    assert 1.2 * SD < first.noise.sd < 3.5 * SD
    errors = PointErrors(0.002, 0.01, shift=0.01, scale=0.02)
    stated = replace(known().likelihood, observations=tuple(replace(one, noise=errors) for one in HERE))
    found = {name: other for name, _, _, other in questions._other_noise(stated)}
    assert found["unknown shift half as large"].observations[0].noise == replace(errors, shift=0.005)
    assert found["unknown scale twice as large"].observations[1].noise == replace(errors, scale=0.04)


def test_the_usual_questions_and_facts_of_noise():
    found = asked(now(), {"tracked_points": TRACKED, "offset": NormalOffset()})
    kinds = ["prior"] * 6 + ["fix"] + ["noise"] * 2 + ["measure"] + ["without"] * 2
    assert [one.kind for one in found.values()] == kinds
    assert facts_of(found["noise half as large"].likelihood) == f"noise variance {NOISE.variance / 4:.4g}"
    errors = replace(HERE[0], noise=PointErrors(0.003, 0.02, shift=0.045, rotation=1.2, scale=0.01))
    words = "point sd 3 µm, correlation length 20 µm, shift sd 45 µm, rotation sd 1.2°, scale sd 1 %"
    assert facts_of(replace(known().likelihood, observations=(errors,))) == words
