"""The questions that every study is asked: other priors, other noise, other measures, fewer conditions."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.unit.calibration.arches import SD, TRACKED, knowledge
from tests.unit.calibration.test_what_if import INPUTS, NOISE, known, now, observed

from strandline.calibration.alternative import Alternative
from strandline.calibration.usual_alternatives import (
    _common_errors,
    facts_of,
    other_priors,
    prior_in_words,
    scaled_noise,
    usual_alternatives,
)
from strandline.discrepancy import NormalOffset
from strandline.interface import GaussianNoise, Observation, PointErrors, UnknownErrors
from strandline.parameters import Parameter
from strandline.priors import LogNormal, LogUniform, Normal, Prior, ScaledBeta, Uniform


def test_widths_of_other_priors() -> None:
    rows: list[tuple[Prior, Prior, Prior | None]] = [
        (Uniform(2.0, 6.0), ScaledBeta(5.5, 5.5, 2.0, 6.0), None),
        (Normal(3.0, 0.7), Normal(3.0, 0.35), Normal(3.0, 1.4)),
        (LogNormal(1.0, 0.2), LogNormal(1.0, 0.1), LogNormal(1.0, 0.4)),
        (ScaledBeta(20.0, 30.0, 2.0, 6.0), ScaledBeta(81.2, 121.8, 2.0, 6.0), ScaledBeta(4.7, 7.05, 2.0, 6.0)),
        (ScaledBeta(2.6, 1.4, 2.0, 6.0), ScaledBeta(12.35, 6.65, 2.0, 6.0), None),
    ]
    levels = (np.arange(20000) + 0.5) / 20000
    for prior, narrower, wider in rows:
        found = dict(other_priors(Parameter("a", prior, box=(2.0, 6.0))))
        for name, expected in (("half as wide", narrower), ("twice as wide", wider)):
            assert (name in found) == (expected is not None)
            if expected is not None:
                assert type(found[name]) is type(expected)
                assert vars(found[name]) == pytest.approx(vars(expected))
        assert ("flat in its box" in found) == (prior != Uniform(2.0, 6.0))
        assert found["flat in its logarithm"] == LogUniform(2.0, 6.0)
        if not isinstance(prior, LogNormal):
            sds = [float(np.std(one.quantile(levels))) for one in (prior, narrower)]
            assert sds[1] / sds[0] == pytest.approx(0.5, abs=2e-3)


class Own(Normal):
    """A prior of the user's."""


def test_priors_without_a_form_of_their_own() -> None:
    found = dict(other_priors(Parameter("a", LogUniform(1.0, math.e**2))))
    assert set(found) == {"half as wide", "flat in its box"}
    assert vars(found["half as wide"])["mu"] == pytest.approx(1.0)
    halved = dict(other_priors(Parameter("a", Own(0.0, 2.0), box=(-5.0, 5.0))))["half as wide"]
    assert isinstance(halved, Normal)
    assert prior_in_words(Normal(350.0, 50.0)) == "normal [350, 50]"
    assert prior_in_words(Own(1.0, 2.0)) != prior_in_words(Normal(1.0, 2.0))


def test_scaled_noise() -> None:
    assert scaled_noise(GaussianNoise(4.0), 0.5) == GaussianNoise(1.0)
    assert scaled_noise(PointErrors(0.01, 0.1, shift=0.02), 2.0) == PointErrors(0.02, 0.1, shift=0.02)
    assert scaled_noise(UnknownErrors(0.01, 0.1, model_error=True), 2.0) == UnknownErrors(0.02, 0.1, model_error=True)
    assert scaled_noise(UnknownErrors(), 2.0) is None


def test_the_usual_questions() -> None:
    found = {one.name: one for one in usual_alternatives(now(), {"tracked_points": TRACKED, "offset": NormalOffset()})}
    assert list(found) == [
        "prior of height half as wide",
        "prior of height twice as wide",
        "prior of height flat in its box",
        "prior of height flat in its logarithm",
        "prior of lean half as wide",
        "prior of lean flat in its box",
        "lean known to be 0.01572",
        "noise half as large",
        "noise twice as large",
        "measure offset",
        "without condition 1",
        "without condition 1.5",
    ]
    likelihood = found["noise half as large"].likelihood
    assert likelihood is not None
    assert facts_of(likelihood) == f"noise variance {NOISE.variance / 4:.4g}"
    assert found["lean known to be 0.01572"].fixed == {"lean": 0.01572}
    assert [one.about for one in found.values()][-1] == "condition 1.5"


def _observations(one: Alternative) -> tuple[Observation, ...]:
    assert one.likelihood is not None
    return one.likelihood.observations


def test_noise_that_is_inferred_is_asked_about_at_its_median() -> None:
    """With a model error, one alternative leaves it out."""
    observations = observed(UnknownErrors(sd=SD, length=0.02, model_error=True))
    mine = replace(now(), knowledge=knowledge(NormalOffset(), observations))
    found = {one.name: one for one in usual_alternatives(mine, {})}
    for one in _observations(found["noise twice as large"]):
        assert isinstance(one.noise, UnknownErrors)
        assert one.noise.model_error
        assert (one.noise.sd, one.noise.length) == (pytest.approx(2 * SD), pytest.approx(0.02))
    for one in _observations(found["no model error"]):
        assert isinstance(one.noise, PointErrors)
        assert (one.noise.sd, one.noise.length) == (pytest.approx(SD), pytest.approx(0.02))
    unknown = replace(now(), knowledge=knowledge(NormalOffset(), observed(UnknownErrors())))
    (twice_as_large,) = (one for one in usual_alternatives(unknown, {}) if one.name == "noise twice as large")
    (first, _) = (seen.noise for seen in _observations(twice_as_large))
    assert isinstance(first, PointErrors)
    assert 1.2 * SD < first.sd < 3.5 * SD


def test_each_error_that_all_points_share_is_halved_and_doubled() -> None:
    errors = PointErrors(0.002, 0.01, shift=0.01, scale=0.02)
    likelihood = known().likelihood
    seen = tuple(replace(one, noise=errors) for one in likelihood.observations)
    found = {one.name: one for one in _common_errors(replace(likelihood, observations=seen), INPUTS)}
    assert len(found) == 4
    for name, stated in (("shift", 0.01), ("scale", 0.02)):
        for words, factor in (("half", 0.5), ("twice", 2.0)):
            (other, _) = _observations(found[f"unknown {name} {words} as large"])
            assert other.noise == replace(errors, **{name: factor * stated})
    assert not list(_common_errors(likelihood, INPUTS))


def test_facts_of_different_noise() -> None:
    here = observed()
    some = (here["1"], replace(here["1.5"], noise=GaussianNoise(2.0)))
    words = facts_of(replace(known().likelihood, observations=some))
    assert words == f"1: noise variance {NOISE.variance:.4g}; 1.5: noise variance 2"
    some = (replace(here["1"], noise=PointErrors(0.003, 0.02, shift=0.045, rotation=1.2, scale=0.01)),)
    words = facts_of(replace(known().likelihood, observations=some))
    assert words == "point sd 3 µm, correlation length 20 µm, shift sd 45 µm, rotation sd 1.2°, scale sd 1 %"
