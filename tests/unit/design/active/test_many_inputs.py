"""Designs and chains of many inputs, on a strip whose stiffness is a field: against the true model."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp
from tests.unit.models.strips import KERNEL, POINTS, S, Strip

import strandline as sl
from strandline.design.active import Active, learn
from strandline.design.active.chains import CHAINS, Normalised, chain_state, drawn_result, sample_by_chains
from strandline.design.active.exact_draws import ExactDraws, Expecting
from strandline.design.active.informed_design import InformedDesign, Told
from strandline.design.refinement import over_prior
from strandline.discrepancy import TrackedPoints
from strandline.likelihood import InterfaceLikelihood
from strandline.parameters.fields import Support
from strandline.smc import Chains, hamiltonian

NOISE = 0.02
DIM = 6
FIELD = sl.GaussianField(1.0, 0.5, 0.3, modes=DIM - 1).on("E", Support.interval(0.0, 1.0, POINTS))
SPACE = sl.ParameterSpace(
    (*FIELD.parameters, sl.Parameter("load", sl.Uniform(1.8, 3.2))), correlation={("E_1", "load"): -0.5}
)
MODEL = sl.WithFields(Strip(sensitivities=True), (FIELD,))
TRUTH = np.array([0.8, -0.5, 0.3, *np.zeros(DIM - 4), 2.5])


def record(x):
    found = MODEL(SPACE.as_mapping(x), Path())
    names = x.tobytes().hex()
    return sl.RunRecord(names, SPACE.as_mapping(x), "ok", found.interfaces, sensitivities=found.sensitivities)


def true_log_likelihood(x):
    w = x[:, -1:] * (np.exp(-x[:, :-1] @ FIELD.modes.T) @ KERNEL.T)
    seen = OBSERVATION.interface.points[:, 1]
    return -0.5 * ((w - seen) ** 2).sum(axis=1) / NOISE**2


def _observation():
    w = MODEL(SPACE.as_mapping(TRUTH), Path()).interface.points[:, 1]
    y = w + NOISE * np.random.default_rng(5).standard_normal(POINTS)
    return sl.Observation(sl.Interface.polyline(np.stack([S, y], axis=1)), NOISE**2)


OBSERVATION = _observation()
LIKELIHOOD = InterfaceLikelihood((OBSERVATION,), TrackedPoints())


@cache
def knowledge(runs):
    random = np.random.default_rng(6)
    near = SPACE.prior_shares(TRUTH[None])
    p = np.clip(near + 0.1 * random.standard_normal((runs, DIM)), 0.02, 0.98)
    x = SPACE.prior_quantiles(p)
    return learn(x, [record(one) for one in x], SPACE, (OBSERVATION,), TrackedPoints())


@cache
def true_posterior():
    """Return draws of the true posterior, by chains on the true model."""

    def density(u):
        return true_log_likelihood(normal.inputs(u)) - 0.5 * (u**2).sum(axis=1)

    normal, random = Normalised(SPACE, knowledge(20)), np.random.default_rng(7)
    state = chain_state(knowledge(20), SPACE, (1,), None)
    options = {"steps": 800, "step": state.step, "leaps": state.leaps}
    found = hamiltonian(density, normal.force, normal.places(state.last), state.root, random, **options)
    return normal.inputs(found.draws[200:].reshape(-1, DIM))


def off(draws, weights=None):
    """Return the largest error of a mean, in sds, and of an sd, as a share."""
    true, weights = true_posterior(), np.full(len(draws), 1 / len(draws)) if weights is None else weights
    mean = weights @ draws
    sd = np.sqrt(weights @ (draws - mean) ** 2)
    return np.abs((mean - true.mean(axis=0)) / true.std(axis=0)).max(), np.abs(sd / true.std(axis=0) - 1).max()


def test_the_force_is_the_slope_of_the_density_of_correlated_inputs():
    normal = Normalised(SPACE, knowledge(12), np.repeat([1.0, 0.5], 3))
    u = 0.5 * np.random.default_rng(8).standard_normal((6, DIM))
    np.testing.assert_allclose(normal.places(normal.inputs(u)), u, atol=1e-9)
    force = normal.force(u)
    for k in range(DIM):
        step = 1e-5 * np.eye(DIM)[k]
        ahead, behind = normal.log_density(u + step), normal.log_density(u - step)
        np.testing.assert_allclose(force[:, k], (ahead - behind) / 2e-5, rtol=1e-4, atol=1e-3)


def test_chains_on_a_good_surrogate_find_the_true_posterior_and_its_evidence():
    found, r_hat = sample_by_chains(knowledge(20), SPACE, 1, 4000, None)
    assert r_hat < 1.03
    mean, width = off(found.positions, np.exp(found.log_weights))
    assert mean < 0.15
    assert width < 0.1
    x = SPACE.prior_quantiles(np.random.default_rng(9).random((400_000, DIM)))
    constant = LIKELIHOOD(record(TRUTH).interfaces) - true_log_likelihood(TRUTH[None])[0]
    logs = true_log_likelihood(x) + constant
    error = np.sqrt(np.exp(logsumexp(2 * logs) - 2 * logsumexp(logs)))
    assert error < 0.1
    assert found.log_evidence == pytest.approx(logsumexp(logs) - np.log(len(x)), abs=3 * error + 0.05)


def test_the_evidence_of_a_normal_density_is_exact():
    class Plain(Normalised):
        def roughly(self, x):
            return -1.5 * (self.places(x) ** 2).sum(axis=1)

    normal, random = Plain(SPACE, knowledge(12)), np.random.default_rng(10)
    draws = 0.5 * random.standard_normal((200, CHAINS, DIM))
    found = drawn_result(normal, Chains(draws, 1.0, 0.1), random, 4000)
    assert found.log_evidence == pytest.approx(DIM * np.log(0.5), abs=0.02)


class Tilted(Expecting):
    """A surrogate that is wrong along two inputs."""

    def roughly(self, x):
        return super().roughly(x) + 0.5 * self.places(x)[:, :2].sum(axis=1)


def test_draws_weighted_by_the_true_model_are_right_even_with_a_wrong_surrogate():
    tilted = Tilted(SPACE, knowledge(12))
    state = chain_state(knowledge(12), SPACE, (1,), None)
    draws, believed = (ExactDraws.of(state, tilted, (3,)) for _ in range(2))
    for k in range(60):
        x = draws.propose()
        draws.take(np.where(np.arange(len(x)) == k % 7, -np.inf, true_log_likelihood(x)))
        believed.take(tilted.roughly(believed.propose()))
    found = draws.result()
    mean, width = off(found.positions, np.exp(found.log_weights))
    assert mean < 0.15
    assert width < 0.1
    assert np.isfinite(found.log_likelihood).all()
    assert len(found.positions) == 60 * (CHAINS - 1)
    assert found.ess == pytest.approx(draws.weights.ess, rel=0.1)
    assert max(off(believed.result().positions)) > 0.25


def design(**options):
    def state(x, records):
        known = learn(x, records, SPACE, (OBSERVATION,), TrackedPoints())
        return chain_state(known, SPACE, (1, len(x)), found.state)

    def log_likelihood(one):
        return LIKELIHOOD(one.interfaces)

    active = Active(runs=80, initial=3, exact=False, **options)
    found = InformedDesign(active, SPACE, batch=4, learn=state, log_likelihood=log_likelihood, seed=1)
    return found


def played(found):
    x = over_prior(SPACE, 3)
    found.start(x)
    while (batch := found.next(x, [record(one) for one in x])) is not None:
        x = np.concatenate([x, batch.points])
    return x


def test_a_design_of_eight_inputs_settles_on_the_true_posterior_in_few_runs():
    found = design()
    x = played(found)
    assert found.converged
    assert len(x) <= 40
    mean, width = off(found.state.positions, np.exp(found.state.log_weights))
    assert mean < 0.3
    assert width < 0.25


def test_where_runs_fail_the_way_to_the_best_fit_is_halved_and_then_given_up():
    found, x = design(), over_prior(SPACE, 3)
    found.start(x)
    records = [record(one) for one in x]
    reached = []
    while (batch := found.next(x, records)).kind == "posterior":
        x = np.concatenate([x, batch.points])
        records.append(sl.RunRecord(batch.points.tobytes().hex(), records[0].inputs, "failed"))
        reached.append(batch.points[0])
    assert batch.kind == "check"
    places = Normalised(SPACE, found.state.knowledge).places
    away = np.linalg.norm(places(np.array(reached))[:, None] - places(x[:3]), axis=2)
    nearest = away[:, away[-1].argmin()]
    np.testing.assert_allclose(nearest[1:] / nearest[:-1], 0.5, rtol=0.1)
    assert len(reached) == 7


def test_a_design_ends_where_half_of_its_draws_fail(monkeypatch):
    monkeypatch.setattr("strandline.design.active.informed_design.PATIENT", 18)
    found, x = design(), over_prior(SPACE, 3)
    found.start(x)
    records = [record(one) for one in x]
    while (batch := found.next(x, records)) is not None:
        fails = [batch.kind == "check" and k % 2 == 0 for k in range(len(batch.points))]
        x = np.concatenate([x, batch.points])
        records += [
            replace(record(one), state="failed", interfaces={}, sensitivities={}) if lost else record(one)
            for one, lost in zip(batch.points, fails, strict=True)
        ]
    assert not found.converged
    assert "at draws of the posterior failed" in found.reasons[0]
    assert len(x) < 60


def told(ratios, wide=0.0, number=20):
    differ = ratios * np.random.default_rng(11).standard_normal(number)
    return Told(differ, np.full(number, wide), np.zeros(number))


def test_draws_that_differ_or_show_mass_elsewhere_do_not_settle_anything():
    assert not told(0.3).reasons
    assert "differ" in told(1.5).reasons[0]
    assert "20 draws" not in told(0.3).reasons
    assert "of its mass" in told(0.3, wide=1.5).reasons[-1]
    assert "only" in told(0.3, number=4).reasons[0]
    assert "possible" in told(0.75, number=13).reasons[0]
    assert "5 of 20 runs" in replace(told(0.3), failed=5, drawn=20).reasons[0]
    assert "agree" in replace(told(0.3), r_hat=1.5).reasons[0]
    assert not replace(told(0.3), wide=np.full(20, -2.0)).reasons
    assert not replace(told(0.3), wide=0.5 * np.random.default_rng(12).standard_normal(20)).reasons
