"""Gaussian fields: their modes against the closed form, their moments, unknown sd and length, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from strandline.foundations import InvalidInput
from strandline.parameters import GaussianField, LogNormal, LogUniform, Normal, Support, Uniform

LINE = Support.interval(0.0, 1.0, 200)
S = LINE.points[:, 0]
FIELD = GaussianField(400.0, 0.5, 0.3, covariance="matern12", modes=12)
UNKNOWN = replace(FIELD, sd=LogNormal(-0.7, 0.4), length=LogUniform(0.1, 0.6))


def exact_modes(length, number):
    """Return variances and functions of exp(-|s - t|/length) on [0, 1]: (w² - c²) tan w = 2 c w with c = 1/length."""
    c, found = 1 / length, []
    for k in range(number):
        low, high = np.pi * k + 1e-9, np.pi * (k + 1) - 1e-9
        w = brentq(lambda w: (w**2 - c**2) * np.sin(w) - 2 * c * w * np.cos(w), low, high)
        shape = w * np.cos(w * S) + c * np.sin(w * S)
        found.append((2 * c / (w**2 + c**2), shape / np.sqrt((shape**2).mean())))
    return np.array([one for one, _ in found]), np.array([shape for _, shape in found]).T


def test_the_modes_of_the_exponential_covariance_are_those_of_the_closed_form():
    modes = FIELD.on("E", LINE).modes
    variances, shapes = exact_modes(0.3, 5)
    np.testing.assert_allclose((modes[:, :5] ** 2).mean(axis=0), 0.25 * variances, rtol=2e-3)
    signs = np.sign((modes[:, :5] * shapes).sum(axis=0))
    np.testing.assert_allclose(modes[:, :5], signs * shapes * 0.5 * np.sqrt(variances), atol=4e-3)


def test_weights_stand_for_lengths():
    """The same modes on points that lie twice as close in one half."""
    points = np.concatenate([Support.interval(0.0, 0.5, 200).points, Support.interval(0.5, 1.0, 100).points])
    uneven = Support(points, np.repeat([0.5 / 200, 0.5 / 100], [200, 100]))
    modes = [FIELD.on("E", one).modes[:, :3] for one in (uneven, LINE)]
    again = np.stack([np.interp(S, points[:, 0], mode) for mode in modes[0].T], axis=1)
    np.testing.assert_allclose(again * np.sign((again * modes[1]).sum(axis=0)), modes[1], atol=4e-3)


def test_the_share_of_variance_and_the_default_number_of_modes():
    variances, _ = exact_modes(0.3, 12)
    assert FIELD.on("E", LINE).share == pytest.approx(variances.sum(), rel=1e-3)
    kept = replace(FIELD, covariance="matern52", modes=None).on("E", LINE)
    assert kept.share >= 0.99
    assert replace(kept.prior, modes=kept.prior.modes - 1).on("E", LINE).share < 0.99
    assert replace(FIELD, modes=200).on("E", LINE).share == pytest.approx(1.0)


@pytest.mark.parametrize("covariance", ["matern12", "matern32", "matern52", "squared_exponential"])
def test_draws_have_the_covariance_and_a_log_field_the_median(covariance):
    field = replace(FIELD, covariance=covariance, modes=40).on("E", Support.interval(0.0, 1.0, 40))
    draws = np.log(field.values(np.random.default_rng(0).standard_normal((20000, 40))))
    r = np.abs(field.support.points - field.support.points.T) / 0.3
    exact = {"matern12": np.exp(-r), "matern32": (1 + 3**0.5 * r) * np.exp(-(3**0.5) * r)}
    exact |= {
        "matern52": (1 + 5**0.5 * r + 5 * r**2 / 3) * np.exp(-(5**0.5) * r),
        "squared_exponential": np.exp(-(r**2) / 2),
    }
    np.testing.assert_allclose(field.modes @ field.modes.T, 0.25 * exact[covariance], atol=1e-9)
    np.testing.assert_allclose(np.cov(draws.T), 0.25 * exact[covariance], atol=0.25 * 6 * 2**0.5 / 20000**0.5)
    np.testing.assert_allclose(draws.mean(axis=0), np.log(400.0), atol=6 * 0.5 / 20000**0.5)
    plain = replace(field.prior, log=False).on("E", field.support)
    np.testing.assert_allclose(plain.values(np.zeros(40)), 400.0)


def test_an_unknown_sd_and_length_are_inputs_and_give_the_same_covariance():
    small = Support.interval(0.0, 1.0, 30)
    field = replace(UNKNOWN, modes=30).on("E", small, "Pa")
    assert field.names[-2:] == ("E_sd", "E_length")
    assert [(one.name, one.unit, one.prior) for one in field.parameters[-2:]] == [
        ("E_sd", "1", UNKNOWN.sd), ("E_length", "mm", UNKNOWN.length)
    ]  # fmt: skip
    assert field.parameters[-1].box == (0.1, 0.6)
    at = np.array([0.7, 0.25])
    columns = [np.log(field.values(np.concatenate([xi, at])) / 400.0) for xi in np.eye(30)]
    r = np.abs(small.points - small.points.T) / 0.25
    np.testing.assert_allclose(np.transpose(columns) @ columns, 0.49 * np.exp(-r), atol=1e-10)


def test_at_its_shortest_length_the_modes_are_the_known_ones():
    xi = np.random.default_rng(1).standard_normal(12)
    known = replace(FIELD, length=0.1).on("E", LINE).values(xi)
    unknown = replace(UNKNOWN, sd=0.5).on("E", LINE)
    np.testing.assert_allclose(unknown.values(np.append(xi, 0.1)), known, rtol=1e-12)
    np.testing.assert_allclose(unknown.values(np.append(xi, 0.1 + 1e-9)), known, rtol=1e-6)


@pytest.mark.parametrize("log", [True, False])
@pytest.mark.parametrize("prior", [FIELD, UNKNOWN, replace(UNKNOWN, sd=0.5), replace(UNKNOWN, length=0.3)])
def test_slopes_are_those_of_finite_differences(prior, log):
    field = replace(prior, log=log, mean=2.0).on("E", Support.interval(0.0, 1.0, 40))
    x = np.array([one.prior.quantile(0.4) for one in field.parameters]) + 0.01
    slopes, h = field.slopes(x), 1e-4
    by = h * np.eye(len(x))
    differences = np.stack([(field.values(x + one) - field.values(x - one)) / (2 * h) for one in by], axis=1)
    np.testing.assert_allclose(slopes, differences, rtol=1e-4, atol=1e-5)
    both = field.values(np.stack([x, x + by[-1]]))
    np.testing.assert_allclose(both, [field.values(x), field.values(x + by[-1])], rtol=1e-14)


def test_the_field_is_smooth_in_the_length():
    field = replace(UNKNOWN, sd=0.5).on("E", LINE)
    xi = np.random.default_rng(2).standard_normal(12)
    lengths = np.linspace(0.15, 0.5, 36)
    values = np.log(field.values(np.column_stack([np.tile(xi, (36, 1)), lengths])))
    first, third = np.abs(np.diff(values, axis=0)).max(), np.abs(np.diff(values, 3, axis=0)).max()
    assert third < 0.02 * first


REFUSED = {
    "length of a field": {"length": 0.0},
    "sd of a field": {"sd": Normal(0.0, 1.0)},
    "mean of a field: got -1": {"mean": -1.0},
    "modes of a field": {"modes": 0},
    "one of matern12, matern32": {"covariance": "cubic"},
    "modes of the field E: got 201; expected at most 200, its points": {"modes": 201},
    "length of the field E: got 0.004 mm; expected at least 0.005 mm": {"length": 0.004},
    "a lower end of at least 0.005 mm": {"length": Uniform(0.0, 1.0)},
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_makes_no_field_is_refused_in_a_line(words):
    with pytest.raises(InvalidInput, match=words) as caught:
        replace(FIELD, **REFUSED[words]).on("E", LINE)
    assert "\n" not in str(caught.value)


@pytest.mark.stand_in
@pytest.mark.parametrize(
    ("words", "made"),
    [
        ("interval of a field", lambda: Support.interval(2, 0, 80)),
        ("points of a field: got 0", lambda: Support.interval(0, 2, 0)),
        ("shape of a field's points", lambda: Support(S, LINE.weights)),
        ("shape of a field's weights", lambda: Support(LINE.points, LINE.weights[1:])),
        ("least weight of a field: got 0", lambda: Support(LINE.points, np.arange(200.0))),
    ],
)
def test_what_makes_no_support_is_refused_in_a_line(words, made):
    with pytest.raises(InvalidInput, match=words) as caught:
        made()
    assert "\n" not in str(caught.value)


def test_values_of_many_draws_are_those_of_each_one():
    points, random = Support.interval(0.0, 1.0, 40), np.random.default_rng(0)
    field = GaussianField(400.0, LogUniform(0.2, 0.8), LogUniform(0.05, 1.0), modes=12).on("E", points)
    inputs = np.column_stack(
        [random.standard_normal((300, 12)), random.uniform(0.2, 0.8, 300), np.geomspace(0.05, 1.0, 300)]
    )
    off = np.log(field.values_of_many(inputs) / field.values(inputs)) / inputs[:, 12:13]
    assert np.abs(off).max() < 0.02
    assert np.sqrt((off**2).mean()) < 0.005
    known = GaussianField(400.0, 0.5, 0.3, modes=12).on("E", points)
    np.testing.assert_array_equal(known.values_of_many(inputs[:, :12]), known.values(inputs[:, :12]))
