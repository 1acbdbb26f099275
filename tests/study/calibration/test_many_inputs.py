"""A calibration of many inputs from end to end: draws of the true posterior, stopped and gone on with."""

from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtri
from tests.unit.models.strips import POINTS, S, Strip

import strandline as sl
from strandline.design.active import Active, exact_draws
from strandline.discrepancy import TrackedPoints
from strandline.foundations import InvalidInput
from strandline.likelihood import InterfaceLikelihood
from strandline.parameters.fields import Support

FIELD = sl.GaussianField(1.0, 0.5, 0.3, modes=6).on("E", Support.interval(0.0, 1.0, POINTS))
FIELD_SPACE = sl.ParameterSpace(FIELD.parameters)
MODEL = sl.WithFields(Strip(sensitivities=True), (FIELD,))


def problem(model=MODEL, field=FIELD):
    truth = dict.fromkeys(field.names, 0.0) | {"E_1": 1.0, "load": 2.0}
    y = model(truth, Path()).interface.points[:, 1] + 0.02 * np.random.default_rng(1).standard_normal(POINTS)
    seen = sl.Observation(sl.Interface.polyline(np.stack([S, y], axis=1)), 0.02**2)
    space = sl.ParameterSpace(field.parameters)
    return sl.Problem(model, space, {"load": 2.0}, (seen,), {"tracked": TrackedPoints()})


class Stopped(Exception):
    pass


def stop_after(number):
    made = []

    def run(record, progress):
        made.append(record)
        if len(made) == number:
            raise Stopped

    return sl.Observer(run=run)


def test_draws_of_the_true_posterior_go_on_after_a_stop_with_the_same_bits(tmp_path, monkeypatch):
    monkeypatch.setattr(exact_draws, "FEWEST", 4)
    monkeypatch.setattr(exact_draws, "EFFECTIVE", 60.0)
    settings = sl.Settings(runs=3, surrogate="field", active=Active(runs=60, exact=True), seed=1)
    whole = sl.calibrate(problem(), settings, ledger=tmp_path / "whole.sqlite")
    assert whole.certificate.converged
    assert "effective draws from" in whole.certificate.drawn
    true = InterfaceLikelihood(problem().observations, TrackedPoints())
    draw = dict(zip(FIELD.names, whole.posterior.draws[7], strict=True)) | {"load": 2.0}
    assert whole.posterior.log_likelihood[7] == pytest.approx(true(MODEL(draw, Path()).interfaces), rel=1e-9)
    with pytest.raises(Stopped):
        sl.calibrate(problem(), settings, ledger=tmp_path / "part.sqlite", observer=stop_after(len(whole.records) // 2))
    resumed = sl.calibrate(problem(), settings, ledger=tmp_path / "part.sqlite")
    np.testing.assert_array_equal(resumed.posterior.draws, whole.posterior.draws)
    assert len(resumed.records) == len(whole.records)


def test_more_inputs_than_a_design_can_learn_without_derivatives_are_refused():
    field = sl.GaussianField(1.0, 0.5, 0.1, modes=30).on("E", Support.interval(0.0, 1.0, 40))
    many = sl.ParameterSpace((*field.parameters, sl.Parameter("load", sl.Uniform(1.0, 3.0))))
    one = problem()
    given = sl.Problem(lambda inputs, workdir: None, many, {}, one.observations, dict(one.discrepancies))
    with pytest.raises(InvalidInput, match="unknown inputs: got 31; expected at most 30, or an active"):
        sl.calibrate(given)


def test_without_derivatives_differences_and_draws_find_the_same_posterior():
    active = Active(runs=120, differences=True, exact=False)
    alone = problem(model=sl.WithFields(Strip(), (FIELD,)))
    found = sl.calibrate(alone, sl.Settings(runs=3, surrogate="field", active=active, seed=1))
    assert found.certificate.converged
    assert len(found.records) < 90
    assert not any(record.sensitivities for record in found.records)
    first, *beside = [ndtri(FIELD_SPACE.prior_shares(row))[0] for row in found.training[[0, *range(3, 9)], None]]
    np.testing.assert_allclose(np.array(beside) - first, 0.3 * np.eye(6), atol=1e-9)
    exact = Active(runs=60, exact=False)
    known = sl.calibrate(problem(), sl.Settings(runs=3, surrogate="field", active=exact, seed=1)).posterior
    assert np.abs((found.posterior.mean - known.mean) / known.sd).max() < 0.2
    assert np.abs(found.posterior.sd / known.sd - 1).max() < 0.15
