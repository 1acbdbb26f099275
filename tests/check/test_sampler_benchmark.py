"""The benchmark of the sampler on few runs and particles: every peer must find our posterior, or it stops."""

import numpy as np
import pytest
from verification.benchmarks import sampler

from strandline.posterior.quadrature import integrate


@pytest.fixture(scope="module")
def task() -> sampler.Task:
    return sampler.two_inputs(60, 1000)


@pytest.fixture(scope="module")
def exact(task):
    return integrate(task.process.mean, np.zeros(2), np.ones(2))


def test_scikit_learn_has_the_same_means():
    for made in (sampler.mean_of_two(60, 40, 1), sampler.mean_of_seven(60, 40, 1)):
        assert made.ratio > 0
        assert made.ours.evaluations == 40


def test_other_ways_of_writing_the_mean_agree(task):
    for written in (sampler.naive_mean, sampler.refactoring_mean):
        mean = written(task.process)
        found = np.array([mean(x) for x in task.initial[:20]])
        np.testing.assert_allclose(found, task.process.mean(task.initial[:20]), rtol=1e-9, atol=1e-8)


def require_nearly(found, exact):
    """Stop if moments or evidence are off by more than few particles explain."""
    mean, sd = sampler.moments(found)
    np.testing.assert_allclose(mean, exact.mean, atol=0.15 * exact.sd.max())
    np.testing.assert_allclose(sd, exact.sd, rtol=0.15)
    assert found[0] == pytest.approx(exact.log_evidence, abs=0.3)


@pytest.mark.long
def test_whole_runs_of_others_are_right(task, exact):
    theirs = sampler.blackjax_run(task, sampler.naive_mean(task.process), 0.5 * exact.sd, 8, 0.9)
    require_nearly(theirs()[0], exact)
    plain, cost = sampler.numpy_run(task, task.process.mean, 0.5 * exact.sd, 8, 0.9)
    require_nearly(plain, exact)
    assert (cost.evaluations - 1000) % 8000 == 0
    assert theirs(2)[1].evaluations == 2 * 1000 * 11


def test_a_wrong_posterior_stops_the_benchmark(task, exact):
    wrong, _ = sampler.numpy_run(task, lambda x: 2 * task.process.mean(x), 0.5 * exact.sd, 8, 0.9)
    with pytest.raises(AssertionError):
        sampler.require_right(wrong, exact)


def test_ratios_are_of_one_evaluation():
    made = sampler.figure("", "", [(sampler.Cost(2.0, 3.0, 10), sampler.Cost(8.0, 9.0, 20))] * 3, "")
    assert (made.ratio, made.cpu_ratio) == pytest.approx((2.0, 1.5))
