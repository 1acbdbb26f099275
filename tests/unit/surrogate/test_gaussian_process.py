"""Prediction, derivatives and precision of a conditioned process, for every kernel."""

from itertools import product

import jax
import numpy as np
import pytest
from tests.unit.surrogate.peers import EVERY, VARIANCE, conditioned, peer, runs

from strandline.foundations import InvalidInput, NumericsError
from strandline.surrogate import KERNELS, batched_mean, condition, validate

MATERN = KERNELS["matern32"]


@EVERY
def test_mean_and_variance_equal_another_implementation(names):
    for name, dim in product(names, (1, 3)):
        x, y, gp = conditioned(name, dim)
        points = np.concatenate([runs(100, dim, seed=1)[0], x[:5]])
        other = peer(name, dim).fit((x - x.mean(axis=0)) / x.std(axis=0), y - y.mean())
        mean, sd = other.predict((points - x.mean(axis=0)) / x.std(axis=0), return_std=True)
        np.testing.assert_allclose(gp.mean(points), mean + y.mean(), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(np.sqrt(gp.variance(points)), sd, rtol=1e-6, atol=1e-9)
        far = x[:1] + 100 * x.std(axis=0)
        np.testing.assert_allclose([gp.mean(far)[0], gp.variance(far)[0]], [y.mean(), VARIANCE])


@EVERY
def test_the_hessian_is_that_of_the_jitted_mean(names):
    """JAX's derivatives are not defined at the runs; the Hessian is continuous there."""
    for name in names:
        x, _, gp = conditioned(name)
        points = runs(20, seed=2)[0]
        hessian = jax.jit(jax.vmap(jax.hessian(lambda p, gp=gp: batched_mean(gp, fused=True)(p[None])[0])))(points)
        np.testing.assert_allclose(gp.hessian(points), hessian, rtol=1e-6, atol=1e-8 * np.abs(hessian).max())
        beside = gp.hessian(x[:3] + 1e-9 * gp.scale)
        np.testing.assert_allclose(gp.hessian(x[:3]), beside, rtol=1e-4, atol=1e-4 * np.abs(beside).max())


@pytest.mark.parametrize("name", ["matern32", "matern52_product"])
def test_the_jitted_mean_equals_the_plain_one(name):
    x, _, gp = conditioned(name)
    points = np.concatenate([runs(30, seed=3)[0], x])
    for fused in (None, True):
        mean = jax.jit(batched_mean(gp, fused=fused))(points)
        np.testing.assert_allclose(mean, gp.mean(points), rtol=1e-10, atol=1e-9)


def test_duplicate_runs_need_a_nugget_and_other_dimensions_are_refused():
    x, y = runs(20)
    twice = np.concatenate([x, x]), np.concatenate([y - 0.5, y + 0.5])
    options = {"kernel": MATERN, "length_scale": 0.8, "signal_variance": 100.0}
    gp = condition(*twice, nugget=1e-6, **options)
    np.testing.assert_allclose(gp.mean(x), y, atol=1e-4)
    with pytest.raises(NumericsError, match="nugget"):
        condition(*twice, nugget=0.0, **options)
    with pytest.raises(InvalidInput, match="3 columns"):
        gp.mean(np.zeros((4, 2)))


def test_residuals_equal_those_of_refitting_without_each_run():
    x, y, gp = conditioned("matern32_product")
    found, u = validate(gp, y), (x - gp.shift) / gp.scale
    for i in range(0, len(y), 9):
        rest = np.arange(len(y)) != i
        mean = peer("matern32_product", 3).fit(u[rest], (y - y.mean())[rest]).predict(u[i : i + 1])
        assert found.residuals[i] == pytest.approx(y[i] - y.mean() - mean[0], abs=1e-8)
    assert found.loo_rms == pytest.approx(np.sqrt(np.mean(found.residuals**2)))


def test_near_mode_is_ten_log_units_but_at_least_ten_runs():
    x, _, gp = conditioned(dim=2)
    y = -40 * ((x - x.mean(axis=0)) / x.std(axis=0) * 0.3) ** 2 @ np.ones(2)
    near, steep = validate(gp, y), validate(gp, 1000 * y)
    assert near.near_mode_count == (y > y.max() - 10).sum() > 10
    assert near.loo_rms_near_mode == pytest.approx(np.sqrt(np.mean(near.residuals[y > y.max() - 10] ** 2)))
    assert set(np.flatnonzero(steep.near_mode)) == set(np.argsort(y)[-10:])
