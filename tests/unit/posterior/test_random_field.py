"""What a posterior knows of a random field, against closed forms for normal coefficients."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import ndtr, ndtri
from tests.unit.report.plots.drawn import posterior_of

from strandline.design.active.campaign import report_batch
from strandline.foundations import InvalidInput
from strandline.parameters import GaussianField, LogUniform, Parameter, ParameterSpace, Support, Uniform
from strandline.posterior import FieldPosterior, from_datatree, prior_conflicts, to_datatree

X = np.linspace(0.0, 1.5, 31)[:, None]
NUMBER = 20_000


def field_of(*, log=True):
    """Return a field on a line whose points stand for lengths that differ."""
    prior = GaussianField(400.0, 0.5 if log else 80.0, 0.4, log=log, modes=20)
    return prior.on("E", Support(X, np.linspace(0.5, 1.5, 31)), "Pa")


def shifted(field, by):
    """Return the field with coefficients N(by, 1): draws of the prior, weighted by exp(by · ξ)."""
    draws = np.random.default_rng(1).standard_normal((NUMBER, field.prior.modes))
    weights = np.exp(draws @ by)
    return FieldPosterior(field, draws, weights / weights.sum())


def test_moments_are_those_of_the_weighted_draws_and_of_a_log_normal_field():
    """Planted: without the weights, all of them are those of the prior."""
    field = field_of()
    by = np.array([0.8, -0.5, 0.3, *[0.0] * 17])
    found, mean, sd = shifted(field, by), np.log(400.0) + field.modes @ by, np.linalg.norm(field.modes, axis=1)
    np.testing.assert_allclose(found.gaussian.mean, mean, atol=0.03)
    np.testing.assert_allclose(found.gaussian.sd, sd, rtol=0.04)
    np.testing.assert_allclose(found.mean, np.exp(mean + sd**2 / 2), rtol=0.04)
    np.testing.assert_allclose(found.sd, np.exp(mean + sd**2 / 2) * np.sqrt(np.expm1(sd**2)), rtol=0.12)
    np.testing.assert_allclose(found.interval(0.8), np.exp(mean + np.outer(ndtri([0.1, 0.9]), sd)), rtol=0.06)
    np.testing.assert_allclose(np.log(found.draws(4000)).mean(axis=0), mean, atol=0.05)
    prior = FieldPosterior(field, found.inputs, np.full(NUMBER, 1 / NUMBER))
    assert np.abs(prior.gaussian.mean - mean).max() > 0.2


def test_the_share_left_is_one_for_the_prior_and_zero_for_a_point_mass():
    field = field_of()
    draws = np.random.default_rng(2).standard_normal((NUMBER, 20))
    equal = np.full(NUMBER, 1 / NUMBER)
    np.testing.assert_allclose(FieldPosterior(field, draws, equal).share_left, 1.0, atol=0.03)
    np.testing.assert_allclose(FieldPosterior(field, np.ones((9, 20)), np.full(9, 1 / 9)).share_left, 0.0, atol=1e-6)
    halved = FieldPosterior(field, 3.0 + 0.5 * draws, equal)
    np.testing.assert_allclose(halved.share_left, 0.5, atol=0.015)
    assert (halved.unknown, FieldPosterior(field, draws, equal).unknown) == (0, 31)
    assert "of the logarithm of E at x = " in halved.statement
    assert halved.statement.endswith("At 0 of 31 points it leaves more than 90%.")


def test_functionals_of_a_gaussian_field_have_the_moments_of_its_averages():
    """Planted: the mean over points that count alike."""
    field = field_of(log=False)
    by = np.array([0.8, -0.5, 0.3, *[0.0] * 17])
    found, weights = shifted(field, by), field.support.weights
    right = X[:, 0] > 0.75
    for part, inside in ((None, np.ones(31, bool)), (right, right), (lambda points: points[:, 0] > 0.75, right)):
        row = (weights * inside) / (weights * inside).sum() @ field.modes
        one, mean, sd = found.mean_over(part), 400.0 + row @ by, np.linalg.norm(row)
        assert one.mean == pytest.approx(mean, abs=0.05 * sd)
        assert one.sd == pytest.approx(sd, rel=0.04)
        assert [one.low, one.high] == pytest.approx(mean + sd * ndtri([0.05, 0.95]), abs=0.1 * sd)
        assert (one.prior_mean, one.prior_sd) == (pytest.approx(400.0, abs=0.05 * sd), pytest.approx(sd, rel=0.04))
    row = weights / weights.sum() @ field.modes
    alike = field.modes.mean(axis=0)
    assert abs((row - alike) @ by) > 0.05 * np.linalg.norm(row), "points that count alike would pass"
    z = (400.0 + field.modes @ by - 420.0) / np.linalg.norm(field.modes, axis=1)
    above = found.share_above(420.0)
    assert (above.mean, above.unit) == (pytest.approx(weights @ ndtr(z) / weights.sum(), abs=0.01), "1")
    thirds = [f"mean, x from {a} to {b} mm" for a, b in (("0", "0.5"), ("0.5", "1"), ("1", "1.5"))]
    assert list(found.functionals) == ["mean", *thirds, "share above 400 Pa"]
    with pytest.raises(InvalidInput, match="part of the field E: got 0 of 31 points"):
        found.mean_over(lambda points: points[:, 0] > 2.0)


def test_coefficients_are_not_listed_and_a_field_has_a_line_of_its_own():
    field = field_of()
    space = (Parameter("nu", Uniform(0.0, 1.0)), *field.parameters)
    draws = np.column_stack([np.full(500, 0.3), np.random.default_rng(3).standard_normal((500, 20))])
    posterior = posterior_of(draws, *space)
    mean = posterior.fields["E"].mean_over()
    assert posterior.line.startswith("nu = 0.3 ± ")
    assert posterior.line.endswith(f"E: field of 20 modes, mean {mean.mean:.0f} ± {mean.sd:.0f} Pa")
    for text in (repr(posterior), posterior._repr_html_(), posterior.space._repr_html_(), repr(posterior.fields["E"])):
        assert ("E_1" in text, "E<sub>" in text, "E" in text) == (False, False, True)
    only = posterior_of(draws[:, 1:], *field.parameters)
    assert (only.line, "<th>MAP</th>" in only._repr_html_()) == (posterior.line.partition(", ")[2], False)
    assert (only.space.scalars, posterior.space.scalars) == ((), ("nu",))
    part = ParameterSpace(field.parameters[:3])
    assert (part.fields, part.scalars) == ((), ()), "some of its coefficients are no field"


@pytest.mark.stand_in
@pytest.mark.stand_in
def test_the_line_of_a_batch_names_a_field_once():
    space = ParameterSpace((Parameter("nu", Uniform(0.0, 1.0)), *field_of().parameters))
    step = SimpleNamespace(mean=np.full(21, 0.3), sd=np.full(21, 0.1), check=None, moved=None)
    design = SimpleNamespace(steps=[step], converged=False, reasons=(), batches=[SimpleNamespace(kind="check")])
    assert report_batch(design, space).posterior == ("nu 0.3 ± 0.1", "E: field of 20 modes")


def test_a_hundred_coefficients_raise_no_more_false_alarms_than_one_input():
    """Planted: a coefficient at five standard deviations of the prior."""
    field, random = field_of(), np.random.default_rng(4)
    alarms, levels = 0, ndtri((np.arange(200) + 0.5) / 200)
    for off in (0.0, *[None] * 150):
        means = np.where(np.arange(20) == 3, 4.9, 0.0) if off == 0.0 else 0.8 * random.standard_normal(20)
        draws = np.clip(means + 0.6 * random.permuted(np.tile(levels, (20, 1)), axis=1).T, -4.99, 4.99)
        found = list(prior_conflicts(posterior_of(draws, *field.parameters)))
        alarms += bool(found) and off is None
        if off == 0.0:
            assert [one[:40] for one in found] == ["The data contradict the prior of E_4, No"]
    assert alarms <= 6


def test_the_file_of_a_posterior_has_what_is_known_at_each_point():
    field = field_of()
    draws = np.random.default_rng(5).standard_normal((300, 20))
    posterior = posterior_of(0.5 * draws, *field.parameters)
    tree = to_datatree(posterior, seed=1)
    found, known = tree["field_E"], posterior.fields["E"]
    np.testing.assert_array_equal(found["points"], X)
    for name, values, unit in (
        ("mean", known.mean, "Pa"),
        ("sd", known.sd, "Pa"),
        ("low", known.interval()[0], "Pa"),
        ("share_of_prior_sd_left", known.share_left, "1"),
    ):
        np.testing.assert_array_equal(found[name], values)
        assert found[name].attrs["units"] == unit
    np.testing.assert_array_equal(from_datatree(tree, posterior.space).draws, posterior.draws)


def test_an_unknown_sd_and_length_count_in_the_prior_and_in_each_draw():
    prior = GaussianField(400.0, LogUniform(0.2, 0.8), LogUniform(0.2, 1.0), modes=12)
    field = prior.on("E", Support(X, np.ones(31)), "Pa")
    space = ParameterSpace((*field.parameters, Parameter("nu", Uniform(0.2, 0.4))), {("E_sd", "nu"): 0.9})
    draws = space.prior_quantiles(np.random.default_rng(1).random((3000, space.dim)))
    found = replace(posterior_of(draws, *space), space=space).fields["E"]
    np.testing.assert_allclose(found.share_left, 1.0, atol=0.08)
    np.testing.assert_allclose(found.values.draws[:20], field.values(draws[:20, :14]), rtol=0.01)
    few = np.tile(draws[:1], (20, 1))
    few[:, 12] = np.linspace(0.2, 0.8, 20)
    known = posterior_of(few, *space).fields["E"]
    log = np.log(field.values(few[:1, :14])[0] / 400.0) / 0.2
    spread = few[:, 12].std() * np.abs(log)
    np.testing.assert_allclose(known.gaussian.sd, spread, rtol=0.02)
    assert posterior_of(draws, *space).space.scalars == ("E_sd", "E_length", "nu")
