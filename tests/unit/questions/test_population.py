"""The population against quadrature, its coverage, shrinkage against the closed form, and planted outliers."""

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import norm

from strandline.parameters import Normal, Parameter, ParameterSpace, Uniform
from strandline.questions.population import population_of, shrunk
from strandline.questions.specimen import Certified, SpecimenPosterior

SPACE = ParameterSpace((Parameter("E", Uniform(100.0, 800.0), "Pa"),))
OWN = 25.0


def specimen(name, mean, sd=OWN, space=SPACE):
    """Return a normal posterior, by draws with its moments."""
    mean, z = np.atleast_1d(mean), norm.ppf((np.arange(64) + 0.5) / 64)[:, None]
    quantiles = mean + np.array([[-1.645], [0.0], [1.645]]) * sd
    parts = mean, np.array([[sd**2]]), quantiles, mean + sd * z / z.std()
    return SpecimenPosterior(name, {}, space, *parts, 1000.0, "importance", Certified(0.0, 1.0))


def specimens(number, *, sd=40.0, seed=0):
    random = np.random.default_rng(seed)
    truths = 400.0 + sd * random.standard_normal(number)
    return tuple(specimen(f"{k:03}", x) for k, x in enumerate(truths + OWN * random.standard_normal(number)))


def by_quadrature(some, own=OWN):
    """Return means and standard deviations of the population's m and s, and E[x_0] of the first specimen."""
    m, s = np.linspace(100, 800, 351)[:, None], np.linspace(0.5, 350, 500)[None, :]

    def in_box(middle, width):
        return np.log(np.maximum(ndtr((800 - middle) / width) - ndtr((100 - middle) / width), 1e-300))

    total = np.sqrt(own**2 + s**2)
    log_density, pulled = np.zeros((len(m), s.shape[1])), []
    for one in some:
        x = float(one.mean[0])
        pulled.append((x * s**2 + m * own**2) / total**2)
        log_density += -0.5 * ((x - m) / total) ** 2 - np.log(total)
        log_density += in_box(pulled[-1], own * s / total) - in_box(m, s)
    weights = np.exp(log_density - log_density.max())
    weights /= weights.sum()
    means = [(weights * value).sum() for value in (m, s)]
    sds = [np.sqrt((weights * (value - mean) ** 2).sum()) for value, mean in zip((m, s), means, strict=True)]
    return means[0], sds[0], means[1], sds[1], (weights * pulled[0]).sum()


@pytest.mark.parametrize(("number", "sd"), [(5, 40.0), (12, 3.0)])
def test_mean_and_spread_are_those_of_quadrature(number, sd):
    """Also for a population that is far narrower than the posteriors; planted: means taken as exact values."""
    some = specimens(number, sd=sd)
    found = population_of(some)
    m, s = 100 + 700 * found.centre[:, 0], 700 * found.width[:, 0]
    for own, right in ((OWN, True), (0.2, False)):
        exact = by_quadrature(some, own)
        errors = ((m.mean() - exact[0]) / exact[1], (s.mean() - exact[2]) / exact[3], s.std() / exact[3] - 1)
        assert bool(np.abs(errors).max() < 0.2) is right


def test_shrunk_means_are_those_of_quadrature_and_the_order_of_specimens_does_not_matter():
    some = specimens(8)
    population = population_of(some)
    lifted = shrunk(population, tuple(one.name for one in some))
    assert abs(lifted.mean[0, 0] - by_quadrature(some)[4]) < 0.08 * OWN
    assert lifted.mean[:, 0].std() < 0.95 * np.std([one.mean[0] for one in some]), "all are pulled to the middle"
    np.testing.assert_array_equal(population_of(some[::-1]).centre, population.centre)


@pytest.mark.parametrize(("far", "others", "seed"), [(0.0, 80, 3), (300.0, 20, 0)], ids=["none", "one"])
def test_outliers_are_named(far, others, seed):
    """Without any, p-values are uniform."""
    some = [*specimens(others, seed=seed), specimen("odd", 400.0 + far)]
    lifted = shrunk(population_of(some), tuple(one.name for one in some))
    assert lifted.outliers == (("odd",) if far else ())
    assert far or abs((lifted.p_values < 0.5).mean() - 0.5) < 0.17


def test_a_prior_counts_once():
    """A prior that pulls each posterior to 300 must not pull the population there."""
    space = ParameterSpace((Parameter("E", Normal(300.0, 30.0), "Pa", (100.0, 800.0)),))
    narrow, free = 1 / np.sqrt(1 / OWN**2 + 1 / 30.0**2), specimens(8)
    some = [specimen(one.name, narrow**2 * (one.mean / OWN**2 + 300 / 30**2), narrow, space) for one in free]
    plain = population_of(free).mean.mean()
    assert abs(population_of(some).mean.mean() - plain) < 12
    assert np.mean([one.mean for one in some]) < plain - 25
