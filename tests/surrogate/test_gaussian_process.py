import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from strandline.errors import InvalidInput, NumericsError
from strandline.surrogate import KERNELS, batched_mean, condition
from strandline.surrogate.gaussian_process import single_precision_error

LENGTH, VARIANCE, NUGGET = 0.8, 2.3, 1e-3


def runs(number=60, dim=2, seed=0):
    rng = np.random.default_rng(seed)
    x = np.array([100.0, -0.8, 5.0])[:dim] + rng.random((number, dim)) * np.array([700.0, 1.3, 0.1])[:dim]
    u = (x - x.mean(axis=0)) / x.std(axis=0)
    return x, np.sin(2 * u).sum(axis=1) - 3 * u[:, 0] ** 2


def conditioned(dim=2, **options):
    x, y = runs(dim=dim)
    chosen = {"length_scale": LENGTH, "signal_variance": VARIANCE, "nugget": NUGGET} | options
    return x, y, condition(x, y, kernel=KERNELS["matern32"], **chosen)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_mean_and_variance_equal_another_implementation(dim):
    x, y, gp = conditioned(dim)
    kernel = ConstantKernel(VARIANCE, "fixed") * Matern(LENGTH, "fixed", nu=1.5)
    other = GaussianProcessRegressor(kernel, alpha=NUGGET, optimizer=None)
    other.fit((x - x.mean(axis=0)) / x.std(axis=0), y - y.mean())
    points = np.concatenate([runs(200, dim, seed=1)[0], x[:5]])
    mean, sd = other.predict((points - x.mean(axis=0)) / x.std(axis=0), return_std=True)
    np.testing.assert_allclose(gp.mean(points), mean + y.mean(), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.sqrt(gp.variance(points)), sd, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_gradient_is_the_finite_difference_of_the_mean(dim):
    x, _, gp = conditioned(dim)
    points = np.concatenate([runs(20, dim, seed=2)[0], x[:3]])
    step = 1e-6 * gp.scale
    for d in range(dim):
        shift = step * np.eye(dim)[d]
        slope = (gp.mean(points + shift) - gp.mean(points - shift)) / (2 * step[d])
        np.testing.assert_allclose(gp.gradient(points)[:, d] * gp.scale[d], slope * gp.scale[d], atol=1e-5)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_hessian_is_the_finite_difference_of_the_gradient(dim):
    _, _, gp = conditioned(dim)
    points = runs(20, dim, seed=2)[0]
    step = 1e-6 * gp.scale
    for d in range(dim):
        shift = step * np.eye(dim)[d]
        bend = (gp.gradient(points + shift) - gp.gradient(points - shift)) / (2 * step[d])
        unit = gp.scale * gp.scale[d]
        np.testing.assert_allclose(gp.hessian(points)[:, d] * unit, bend * unit, atol=1e-4)


def test_hessian_at_a_training_point_is_the_limit_of_those_around_it():
    x, _, gp = conditioned()
    unit = np.outer(gp.scale, gp.scale)
    errors = []
    for distance in (1e-2, 1e-3, 1e-4):
        around = x[4] + distance * gp.scale * np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
        errors.append(np.abs((gp.hessian(around) - gp.hessian(x[4:5])) * unit).max())
    assert np.isfinite(gp.hessian(x[4:5])).all()
    assert errors[1] < 0.2 * errors[0]
    assert errors[2] < 0.2 * errors[1]


@pytest.mark.parametrize("fused", [False, True, None])
def test_the_jitted_mean_equals_the_plain_one(fused):
    x, _, gp = conditioned()
    points = np.concatenate([runs(300, seed=3)[0], x])
    np.testing.assert_allclose(jax.jit(batched_mean(gp, fused=fused))(points), gp.mean(points), rtol=1e-11, atol=1e-10)


def test_the_jitted_mean_is_smooth_enough_for_jax_away_from_the_runs():
    _, _, gp = conditioned()
    points = runs(30, seed=4)[0]
    slope = jax.grad(lambda p: jnp.sum(batched_mean(gp)(p)))(jnp.asarray(points))
    np.testing.assert_allclose(slope, gp.gradient(points), rtol=1e-8, atol=1e-10)


def test_many_points_are_taken_in_blocks(monkeypatch):
    _, _, gp = conditioned()
    points = runs(50, seed=5)[0]
    whole = gp.mean(points), gp.variance(points), gp.hessian(points)
    monkeypatch.setattr("strandline.surrogate.gaussian_process._PAIRS_PER_BLOCK", 7 * len(gp.x_train))
    for in_blocks, at_once in zip((gp.mean(points), gp.variance(points), gp.hessian(points)), whole, strict=True):
        np.testing.assert_allclose(in_blocks, at_once, rtol=1e-12, atol=1e-12)


def test_units_of_the_inputs_do_not_matter():
    x, y, gp = conditioned()
    factor, offset = np.array([1e-3, 40.0]), np.array([-7.0, 2.0])
    other = condition(
        factor * x + offset,
        y,
        kernel=KERNELS["matern32"],
        length_scale=LENGTH,
        signal_variance=VARIANCE,
        nugget=NUGGET,
    )
    points = runs(30, seed=6)[0]
    np.testing.assert_allclose(other.mean(factor * points + offset), gp.mean(points), rtol=1e-9)
    np.testing.assert_allclose(other.gradient(factor * points + offset) * factor, gp.gradient(points), rtol=1e-6)


def test_far_from_all_runs_the_prior_comes_back():
    x, y, gp = conditioned()
    far = x[:1] + 100 * gp.scale
    np.testing.assert_allclose(gp.mean(far), y.mean())
    np.testing.assert_allclose(gp.variance(far), VARIANCE)


def test_duplicate_runs_need_a_nugget_and_are_averaged():
    x, y = runs(20)
    twice = np.concatenate([x, x]), np.concatenate([y - 0.5, y + 0.5])
    options = {"kernel": KERNELS["matern32"], "length_scale": LENGTH, "signal_variance": 100.0}
    np.testing.assert_allclose(condition(*twice, nugget=1e-6, **options).mean(x), y, atol=1e-4)
    with pytest.raises(NumericsError, match="nugget"):
        condition(*twice, nugget=0.0, **options)


def test_an_input_that_never_varies_is_refused():
    x, y = runs()
    x[:, 1] = 0.3
    with pytest.raises(InvalidInput, match="column 1"):
        condition(x, y, kernel=KERNELS["matern32"], length_scale=1.0, signal_variance=1.0, nugget=1e-3)


def test_points_of_another_dimension_are_refused():
    _, _, gp = conditioned()
    with pytest.raises(InvalidInput, match="2 columns"):
        gp.mean(np.zeros((4, 3)))


@pytest.mark.parametrize("name", ["matern32", "matern32_product"])
@pytest.mark.parametrize("fused", [False, True])
def test_single_precision_is_as_exact_as_it_says(name, fused):
    x, y = runs(200)
    gp = condition(x, y, kernel=KERNELS[name], length_scale=0.7, signal_variance=2.0, nugget=1e-3)
    points = runs(3000, seed=7)[0]
    mean = jax.jit(batched_mean(gp, fused=fused, precision="float32"))(points)
    error = np.abs(np.asarray(mean) - gp.mean(points)).max()
    assert mean.dtype == np.float64
    assert 1e-9 < error < single_precision_error(gp) < 0.02


def test_single_precision_is_refused_where_it_would_be_wrong(monkeypatch):
    x, y = runs(300)
    gp = condition(x, 10 * y, kernel=KERNELS["matern32"], length_scale=50.0, signal_variance=3e7, nugget=1e-4)
    points = runs(500, seed=7)[0]
    said = single_precision_error(gp)
    with pytest.raises(InvalidInput, match=rf"single precision: got {float(f'{said:.2g}')}; expected at most 0\.02"):
        batched_mean(gp, precision="float32")
    np.testing.assert_allclose(
        jax.jit(batched_mean(gp, precision="auto"))(points), gp.mean(points), rtol=1e-6, atol=1e-5
    )
    monkeypatch.setattr("strandline.surrogate.gaussian_process.SINGLE_PRECISION_LIMIT", np.inf)
    error = np.abs(jax.jit(batched_mean(gp, precision="float32"))(points) - gp.mean(points)).max()
    assert 0.02 < error < said


def test_auto_takes_single_precision_where_it_is_allowed():
    _, _, gp = conditioned()
    points = runs(50, seed=7)[0]
    single, chosen = (jax.jit(batched_mean(gp, precision=precision))(points) for precision in ("float32", "auto"))
    np.testing.assert_array_equal(single, chosen)
