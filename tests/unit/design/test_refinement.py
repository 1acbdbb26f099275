"""Rounds of runs where the posterior lies, on a curved ridge whose posterior is known."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from tests.densities import banana

import strandline as sl
from strandline.design.refinement import Learnt, Refinement, Round, refine, shifts

EXACT = banana(centre=1.0, sd=0.5, bend=0.6, width=0.4)
SPACE = sl.ParameterSpace(
    tuple(sl.Parameter(n, sl.Uniform(float(a), float(b))) for n, a, b in zip("xy", EXACT.low, EXACT.high, strict=True))
)
TWO = Refinement(rounds=2, runs=20)
ONE = replace(TWO, rounds=1)
FIRST = SPACE.to_physical(sl.sobol(24, 2))


def extend(known, points, *, fails_below=-np.inf):
    """Learn from the exact log-likelihood; further runs with x below a limit fail."""
    limit = -np.inf if known is None else fails_below
    records = tuple(
        sl.RunRecord(row.tobytes().hex(), SPACE.as_mapping(row), "ok" if row[0] >= limit else "failed")
        for row in points
    )
    if known is not None:
        points, records = np.concatenate([known.design, points]), (*known.records, *records)
    training = points[[record.ok for record in records]]
    values = np.asarray(EXACT.log_likelihood(training))
    return Learnt(points, records, training, {"exact": values}, {"exact": sl.fit_log_likelihood(training, values)})


def forgetful(known, points):
    """Planted bug: the refit leaves the new runs out."""
    whole = extend(known, points)
    return whole if known is None else replace(whole, surrogates=known.surrogates)


def refined(how=extend, refinement=TWO):
    return refine(how(None, FIRST), how, SPACE, refinement, particles=1000, seed=1)


def distance(learnt):
    """Return half the integral of |posterior of the surrogate - exact posterior|, from a fine grid."""
    axes = [np.linspace(a, b, 81) for a, b in zip(EXACT.low, EXACT.high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    values = (f(points) for f in (learnt.surrogate.process.mean, EXACT.log_likelihood))
    one, other = (np.exp(v - v.max()) / np.exp(v - v.max()).sum() for v in values)
    return 0.5 * float(np.abs(one - other).sum())


@pytest.fixture(scope="module")
def found():
    return refined()


def test_the_posterior_comes_closer_to_the_exact_one_and_the_error_at_new_runs_falls(found):
    """Planted bug: neither falls if the refit leaves the new runs out."""
    learnt, (first, last) = found
    before = distance(extend(None, FIRST))
    assert before > 0.15
    assert distance(learnt) < 0.35 * before
    sd = np.sqrt(np.diagonal(EXACT.covariance))
    errors = [np.max(np.abs(r.mean - EXACT.mean) / sd) for r in (first, last)]
    assert errors[1] < 0.3
    assert errors[0] > 2 * errors[1]
    assert last.error_rms_posterior < 0.3 * first.error_rms_posterior
    learnt, (first, last) = refined(forgetful)
    assert distance(learnt) == before
    assert last.error_rms_posterior > 0.5 * first.error_rms_posterior


def test_the_account_is_of_the_surrogate_before_and_of_the_new_runs(found):
    learnt, rounds = found
    assert [(r.n_train, r.runs, r.failed) for r in rounds] == [(24, 20, 0), (44, 20, 0)]
    assert len(np.unique(learnt.design, axis=0)) == len(learnt.records) == 64
    first, new = extend(None, learnt.design[:24]).surrogate.process, learnt.design[24:44]
    error = first.mean(new) - np.asarray(EXACT.log_likelihood(new))
    assert rounds[0].error_rms == pytest.approx(np.sqrt(np.mean(error**2)))
    assert rounds[0].error_rms_posterior == pytest.approx(np.sqrt(np.mean(error[:10] ** 2)))


def test_half_of_the_runs_cover_the_flanks_unless_the_temperature_is_one(found):
    own, flanks = (found[0].log_likelihood[k : k + 10] for k in (44, 54))
    assert flanks.mean() < own.mean() - 0.5
    everywhere, (only,) = refined(refinement=replace(ONE, temperature=1.0))
    assert len(everywhere.records) == 44
    assert only.error_rms == only.error_rms_posterior


def test_failed_runs_are_counted_and_teach_nothing():
    learnt, rounds = refined(partial(extend, fails_below=1.0), ONE)
    failed = int((learnt.design[24:, 0] < 1.0).sum())
    assert 0 < failed == rounds[0].failed < 20
    assert len(learnt.training) == 44 - failed
    assert learnt.training[24:, 0].min() >= 1.0
    _, rounds = refined(partial(extend, fails_below=np.inf), ONE)
    assert (rounds[0].failed, rounds[0].error_rms, rounds[0].error_rms_posterior) == (20, None, None)


def test_shifts_are_those_from_one_posterior_to_the_next():
    rounds = [Round(10, 5, 0, None, None, np.array([m, 0.0]), np.array([s, 1.0])) for m, s in ((0.0, 1.0), (1.0, 2.0))]
    found = shifts(tuple(rounds), np.array([4.0, 1.0]), np.array([6.0, 2.0]))
    np.testing.assert_allclose(found, [[0.5, 0.0], [0.5, 0.5]])
