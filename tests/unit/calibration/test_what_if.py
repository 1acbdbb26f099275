"""Posteriors under other assumptions against quadrature of the true model, planted bugs, and the usual questions."""

import math
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import log_softmax, logsumexp
from tests.unit.calibration.arches import SD, SPACE, TRACKED, TRUTH, Exact, knowledge, seen, true_log_likelihood

from strandline.calibration import usual_alternatives as questions
from strandline.calibration import what_if as module
from strandline.calibration.alternative import Alternative, present
from strandline.calibration.usual_alternatives import facts_of, other_priors, prior_in_words, scaled_noise, with_prior
from strandline.calibration.what_if import answered
from strandline.design import sobol
from strandline.discrepancy import ClosestPoint, NormalOffset
from strandline.errors import InvalidInput
from strandline.interface import GaussianNoise, Observation, PointErrors, UnknownErrors
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.posterior.pareto_smoothing import pareto_smoothed
from strandline.priors import LogNormal, LogUniform, Normal, ScaledBeta, Uniform

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
    return present(weighted_prior(INPUTS, DRAWS), known())


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
        found = answered(now(), alternative, seed=1)
        assert found.by == ("importance" if name in ("far prior", "much sharper") else "reweighting"), name
        assert (found.log_evidence_change is not None) == alternative.by_prior_alone
        assert distance(found, truth, evidence=alternative.by_prior_alone) < FAR, name
        for what, change in PLANTED.get(name, []):
            with pytest.MonkeyPatch.context() as patch:
                if callable(change):
                    patch.setattr(module, what, change)
                start = now() if callable(change) else replace(now(), **{what: change})
                assert distance(answered(start, alternative, seed=1), truth) > 2 * FAR, what


def test_a_fixed_input_is_known():
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
    assert found.by == "importance"
    assert abs(found.draws.mean[0] - mean) < FAR * sd / math.sqrt(found.effective)
    assert abs(found.draws.sd[0] / sd - 1) < FAR / math.sqrt(2 * found.effective)
    assert abs(found.log_evidence_change - change) < FAR / math.sqrt(found.effective)
    assert (found.draws.draws[:, 1] == 0.02).all()
    assert np.isnan([found.shift[1], found.sd_ratio[1]]).all()
    assert "lean" not in found.moved
    with pytest.raises(InvalidInput, match="at least one calibrated input left"):
        Alternative("all", "fix", "", INPUTS, fixed={"height": TRUTH[0]})


def test_inputs_outside_the_old_prior_are_sampled_again_and_tempering_takes_over_where_that_fails(monkeypatch):
    """Weights of draws cannot show what lies where there are none: the tail of the weights looks harmless."""
    posterior = weighted_prior(with_prior(INPUTS, {"lean": Uniform(-0.1, 0.05)}), 2048)
    wide = Alternative("wide", "prior", "", with_prior(INPUTS, {"lean": Uniform(-0.1, 0.2)}))
    found = answered(present(posterior, known()), wide, seed=1)
    assert found.by == "importance"
    assert distance(found, Exact(wide.space, HERE)) < FAR
    alone = answered(present(posterior, None, why_not="no surrogate"), wide, seed=1)
    assert (alone.by, alone.why_not, alone.size) == (None, "no surrogate", 0.0)
    monkeypatch.setattr(module, "followed", lambda *given, **options: None)
    alternative, observations, _ = CASES["far prior"]()
    found, truth = answered(now(), alternative, seed=1), Exact(alternative.space, observations)
    assert found.by == "smc"
    assert np.abs((found.draws.mean - truth.mean) / truth.sd).max() < 0.2
    assert np.abs(found.draws.sd / truth.sd - 1).max() < 0.15
    assert found.log_evidence_change == pytest.approx(truth.log_evidence - exact_now().log_evidence, abs=0.2)


def test_without_a_surrogate_or_with_a_coarse_one_or_of_another_likelihood_only_priors_are_answered(monkeypatch):
    stored = replace(now(), knowledge=None, why_not="there is none")
    assert answered(stored, CASES["narrow prior"]()[0], seed=1).by == "reweighting"
    assert answered(stored, CASES["wider"]()[0], seed=1).why_not == "there is none"
    assert {one.kind for one in asked(stored).values()} == {"prior", "fix"}
    right = module.quality_at
    monkeypatch.setattr(module, "quality_at", lambda *given: replace(right(*given), beyond=0.4))
    found = answered(now(), CASES["wider"]()[0], seed=1)
    assert (found.by, found.draws) == (None, None)
    assert found.why_not == "the surrogate of the interface is too coarse at 40 % of its draws"
    assert np.isnan(found.shift_error).all()
    posterior = Posterior(INPUTS, now().draws, now().log_weights, now().log_likelihood, now().log_prior, 0.0)
    without = present(replace(posterior, log_likelihood=-300.0 * (np.arange(DRAWS) % 97)), known())
    assert without.knowledge is None
    assert "effective draws" in without.why_not
    all_of_them = lambda *given: replace(right(*given), beyond=1.0)  # noqa: E731
    monkeypatch.setattr("strandline.calibration.alternative.quality_at", all_of_them)
    without = present(posterior, known())
    assert without.knowledge is None
    assert without.why_not.startswith("the surrogate of the interface is too coarse at 100 %")
    assert re.search(r"draws: it errs by \S+ µm, and the local noise hides \S+ µm$", without.why_not)


def test_errors_of_shifts_cover_their_scatter_and_what_does_not_change_does_not_move():
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
    found = answered(now(), CASES["much sharper"]()[0], seed=1)
    assert found.moves
    assert found.size > 1
    same = answered(now(), Alternative("same", "prior", "", INPUTS), seed=1)
    assert same.moved == ()
    smoothed = [*same.shift, *(same.sd_ratio - 1), *same.shift_error]
    np.testing.assert_allclose(smoothed, 0, atol=2e-3)  # the smoothing of the largest weights
    assert same.log_evidence_change == pytest.approx(0, abs=1e-12)


class Own(Normal):
    """A prior of the user's."""


def test_widths_of_other_priors_and_scaled_noise():
    levels = (np.arange(20000) + 0.5) / 20000
    for prior, narrower, wider in (
        (Uniform(2.0, 6.0), ScaledBeta(5.5, 5.5, 2.0, 6.0), None),
        (Normal(3.0, 0.7), Normal(3.0, 0.35), Normal(3.0, 1.4)),
        (LogNormal(1.0, 0.2), LogNormal(1.0, 0.1), LogNormal(1.0, 0.4)),
        (ScaledBeta(20.0, 30.0, 2.0, 6.0), ScaledBeta(81.2, 121.8, 2.0, 6.0), ScaledBeta(4.7, 7.05, 2.0, 6.0)),
        (ScaledBeta(2.6, 1.4, 2.0, 6.0), ScaledBeta(12.35, 6.65, 2.0, 6.0), None),
    ):
        found = dict(other_priors(Parameter("a", prior, box=(2.0, 6.0))))
        for name, expected in (("half as wide", narrower), ("twice as wide", wider)):
            assert type(found.get(name)) is type(expected)
            assert expected is None or vars(found[name]) == pytest.approx(vars(expected))
        assert ("flat in its box" in found) == (prior != Uniform(2.0, 6.0))
        assert found["flat in its logarithm"] == LogUniform(2.0, 6.0)
        if not isinstance(prior, LogNormal):
            sds = [float(np.std(one.quantile(levels))) for one in (prior, narrower)]
            assert sds[1] / sds[0] == pytest.approx(0.5, abs=2e-3)
    found = dict(other_priors(Parameter("a", LogUniform(1.0, math.e**2))))
    assert set(found) == {"half as wide", "flat in its box"}
    assert found["half as wide"].mu == pytest.approx(1.0)
    halved = dict(other_priors(Parameter("a", Own(0.0, 2.0), box=(-5.0, 5.0))))["half as wide"]
    assert isinstance(halved, Normal)
    assert prior_in_words(Normal(350.0, 50.0)) == "normal [350, 50]"
    assert prior_in_words(Own(1.0, 2.0)) != prior_in_words(Normal(1.0, 2.0))
    assert scaled_noise(GaussianNoise(4.0), 0.5) == GaussianNoise(1.0)
    assert scaled_noise(PointErrors(0.01, 0.1, shift=0.02), 2.0) == PointErrors(0.02, 0.1, shift=0.02)
    assert scaled_noise(UnknownErrors(0.01, 0.1, model_error=True), 2.0) == UnknownErrors(0.02, 0.1, model_error=True)
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
            assert kind is PointErrors or one.noise.model_error
    first, _ = inferred(UnknownErrors())["noise twice as large"].likelihood.observations
    assert isinstance(first.noise, PointErrors)
    assert 1.2 * SD < first.noise.sd < 3.5 * SD
    errors, likelihood = PointErrors(0.002, 0.01, shift=0.01, scale=0.02), known().likelihood
    stated = replace(likelihood, observations=tuple(replace(one, noise=errors) for one in likelihood.observations))
    found = {one.name: one for one in questions._common_errors(stated, INPUTS)}
    assert len(found) == 4
    for name in ("shift", "scale"):
        for words, factor in (("half", 0.5), ("twice", 2.0)):
            first, _ = found[f"unknown {name} {words} as large"].likelihood.observations
            assert first.noise == replace(errors, **{name: factor * getattr(errors, name)})
    assert not list(questions._common_errors(likelihood, INPUTS))


def test_the_usual_questions_and_facts_of_noise():
    found = asked(now(), {"tracked_points": TRACKED, "offset": NormalOffset()})
    kinds = ["prior"] * 6 + ["fix"] + ["noise"] * 2 + ["measure"] + ["without"] * 2
    assert [one.kind for one in found.values()] == kinds
    assert {"prior of lean flat in its box", "noise twice as large", "measure offset"} < set(found)
    assert facts_of(found["noise half as large"].likelihood) == f"noise variance {NOISE.variance / 4:.4g}"
    assert found["lean known to be 0.01572"].fixed == {"lean": 0.01572}
    assert found["without condition 1.5"].about == "condition 1.5"
    first, second = HERE
    errors = replace(first, noise=PointErrors(0.003, 0.02, shift=0.045, rotation=1.2, scale=0.01))
    some = {"1: noise variance 0.0625; 1.5: noise variance 2": (first, replace(second, noise=GaussianNoise(2.0)))}
    some["point sd 3 µm, correlation length 20 µm, shift sd 45 µm, rotation sd 1.2°, scale sd 1 %"] = (errors,)
    for words, observations in some.items():
        assert facts_of(replace(known().likelihood, observations=observations)) == words
