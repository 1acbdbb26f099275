"""One kernel for all modes: against a Gaussian process that is conditioned without any shortcut."""

import numpy as np
import pytest

from strandline.surrogate.field import shared_process
from strandline.surrogate.field.mode_process import ModeData
from strandline.surrogate.field.shared_process import NUGGET, fit_shared, mean_with_slopes

DIM, RUNS = 7, 5
RANDOM = np.random.default_rng(3)
A = RANDOM.standard_normal((DIM, 2)) * np.linspace(1.0, 0.1, DIM)[:, None]


def values_and_slopes(z):
    inner = z @ A
    values = np.stack([np.sin(inner[:, 0]) + 0.3 * inner[:, 1], np.exp(0.4 * inner[:, 1])], axis=1)
    slopes = np.stack(
        [np.cos(inner[:, :1]) * A[:, 0] + 0.3 * A[:, 1], 0.4 * np.exp(0.4 * inner[:, 1:]) * A[:, 1]], axis=1
    )
    return values, slopes


Z = RANDOM.standard_normal((RUNS, DIM))
PLACES = RANDOM.standard_normal((6, DIM))


def fitted(z):
    values, slopes = values_and_slopes(z)
    return fit_shared([ModeData(z, values[:, m], slopes[:, m], True) for m in range(2)])


def plainly(process, z, values, slopes, at):
    """Return mean and variance at a point by the whole covariance matrix of values and derivatives."""
    w, v = process.kernel.weighed(z), process.kernel.weighed(at)
    by_w = np.linalg.solve(process.kernel.weighing, slopes.T).T
    n, d = w.shape
    E = np.exp(w @ w.T)
    K = np.zeros((n, 1 + d, n, 1 + d))
    K[:, 0, :, 0] = E
    K[:, 0, :, 1:] = E[:, :, None] * w[:, None, :]
    K[:, 1:, :, 0] = np.moveaxis(E[:, :, None] * w[None, :, :], 2, 1)
    K[:, 1:, :, 1:] = np.einsum("ij,ab->iajb", E, np.eye(d)) + np.einsum("ij,ja,ib->iajb", E, w, w)
    K = K.reshape(n * (1 + d), -1) + NUGGET * np.eye(n * (1 + d))
    k = np.exp(v @ w.T)
    rows = np.concatenate([k[:, :, None], k[:, :, None] * v[:, None, :]], axis=2).reshape(len(v), -1)
    data = np.concatenate([(values - process.offset)[:, None], by_w], axis=1).ravel()
    mean = process.offset + rows @ np.linalg.solve(K, data)
    variance = np.exp((v**2).sum(axis=1)) - np.einsum("pr,pr->p", rows, np.linalg.solve(K, rows.T).T)
    return mean, process.scale * variance


@pytest.mark.parametrize("choosing", [3, 40])
def test_means_variances_and_left_out_runs_are_those_of_the_whole_process(choosing, monkeypatch):
    monkeypatch.setattr(shared_process, "CHOOSING", choosing)
    processes = fitted(Z)
    values, slopes = values_and_slopes(Z)
    for m, process in enumerate(processes):
        mean, variance = plainly(process, Z, values[:, m], slopes[:, m], PLACES)
        np.testing.assert_allclose(process.mean(PLACES), mean, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(process.variance(PLACES), variance, rtol=1e-5, atol=1e-7 * process.scale)
        np.testing.assert_allclose(np.diag(process.covariance(PLACES, PLACES)), variance, rtol=1e-5, atol=1e-7)
        found = process.left_out()
        for run in range(RUNS):
            kept = np.arange(RUNS) != run
            mean, variance = plainly(process, Z[kept], values[kept, m], slopes[kept, m], Z[run : run + 1])
            assert found.errors[run] == pytest.approx(values[run, m] - mean[0], rel=1e-3, abs=1e-5)
            assert found.variances[run] == pytest.approx(variance[0], rel=1e-3, abs=1e-5)


def test_it_interpolates_runs_and_their_derivatives_and_its_slopes_are_those_of_its_mean():
    processes = fitted(Z)
    values, slopes = values_and_slopes(Z)
    mean, by_inputs = mean_with_slopes(processes, Z)
    np.testing.assert_allclose(mean, values, atol=2e-4)
    np.testing.assert_allclose(by_inputs(np.tile([1.0, 0.0], (RUNS, 1))), slopes[:, 0], atol=1e-3)
    mean, by_inputs = mean_with_slopes(processes, PLACES)
    factors = RANDOM.standard_normal((6, 2))
    direction = RANDOM.standard_normal(DIM)
    ahead, behind = (mean_with_slopes(processes, PLACES + step * direction)[0] for step in (1e-5, -1e-5))
    differences = ((ahead - behind) * factors).sum(axis=1) / 2e-5
    np.testing.assert_allclose(by_inputs(factors) @ direction, differences, rtol=1e-6, atol=1e-8)


def test_more_runs_predict_better():
    few, many = fitted(Z), fitted(RANDOM.standard_normal((25, DIM)))
    truth = values_and_slopes(PLACES)[0]
    errors = [np.abs(mean_with_slopes(one, PLACES)[0] - truth).max() for one in (few, many)]
    assert errors[1] < 0.3 * errors[0]


def test_from_values_alone_it_is_the_process_of_the_directions_that_they_show():
    z, places = 0.4 * np.random.default_rng(4).standard_normal((30, DIM)), 0.4 * PLACES
    values, _ = values_and_slopes(z)
    processes = fit_shared([ModeData(z, values[:, m], None, True) for m in range(2)])
    kernel = processes[0].kernel
    w, v = kernel.weighed(z), kernel.weighed(places)
    K, k = np.exp(w @ w.T) + NUGGET * np.eye(30), np.exp(v @ w.T)
    for m, process in enumerate(processes):
        expected = process.offset + k @ np.linalg.solve(K, values[:, m] - process.offset)
        np.testing.assert_allclose(process.mean(places), expected, rtol=1e-6, atol=1e-8)
        variance = np.exp((v**2).sum(axis=1)) - np.einsum("pr,pr->p", k, np.linalg.solve(K, k.T).T)
        np.testing.assert_allclose(process.variance(places), process.scale * variance, rtol=1e-4, atol=1e-7)
        inverse = np.linalg.inv(K)
        errors = inverse @ (values[:, m] - process.offset) / np.diag(inverse)
        np.testing.assert_allclose(process.left_out().errors, errors, rtol=1e-4, atol=1e-8)
    _, by_inputs = mean_with_slopes(processes, places)
    for k in range(DIM):
        step = 1e-5 * np.eye(DIM)[k]
        ahead, behind = (mean_with_slopes(processes, places + one)[0] for one in (step, -step))
        for m in range(2):
            slopes = by_inputs(np.tile(np.eye(2)[m], (len(places), 1)))[:, k]
            np.testing.assert_allclose(slopes, (ahead - behind)[:, m] / 2e-5, rtol=1e-4, atol=1e-6)
    directions = np.linalg.eigh(kernel.weighing @ kernel.weighing.T)[1]
    of_two, _ = np.linalg.qr(A)
    assert np.linalg.svd(of_two.T @ directions[:, -2:], compute_uv=False).min() > 0.999
    found, _ = mean_with_slopes(processes, places)
    assert np.abs(found - values_and_slopes(places)[0]).max() < 0.03
