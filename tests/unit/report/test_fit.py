"""What is said of a model that fits, of one that does not, and of an observation that no run comes near."""

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.unit.report.fits import BAD, FINE, condition, misfit, verdict

from strandline.calibration import Misfit, Problem
from strandline.calibration.misfit import FitVerdict, unlikely_errors, with_fitted_noise
from strandline.discrepancy import DISCREPANCIES
from strandline.interface import Interface, Observation, PointErrors, UnknownErrors
from strandline.likelihood import InterfaceLikelihood
from strandline.likelihood.noise_rule import StatedErrors
from strandline.models.protocol import Simulation
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.report.fit import Nearest, fit_as_json, nearest_runs, nothing_near
from strandline.report.warnings import noise_at_an_end
from strandline.runs import RunRecord

END = "trust neither mean nor width of the posterior."
EXPLAINED = "The model explains the observation: p = 0.43"


def test_a_model_that_fits() -> None:
    """A small p-value of some part is not hidden by that of all."""
    but = "but look at the residuals: 4 times the smallest p-value is 0.024."
    assert verdict(condition(FINE), waves=0.006) == FitVerdict(f"{EXPLAINED}, {but}", flagged=False)


def test_a_model_that_does_not_fit_and_where() -> None:
    """Only the reason is given: a corrected p-value that is not small is none; residuals that are long are."""
    found = verdict(condition(FINE, BAD), p=0.004)
    assert found.flagged
    assert found.text == (
        "The model does not explain the observation (p = 0.0016): near s = 0.9–1.1 mm of condition V50 the observed "
        "interface lies 6 µm above the prediction (towards larger y), 5.2 times the standard deviation of that mean; "
        f"{END}"
    )
    everywhere = (replace(BAD, begin=0.0, end=0.4, p_value=0.002), BAD)
    for regions, options, words in (
        ((FINE, BAD), {"waves": 1e-5}, "(p < 0.001 over the whole interface): near s = 0.9–1.1 mm"),
        (everywhere, {"p": 0.004}, ": everywhere, most near s = 0.9–1.1 mm of"),
        ((replace(BAD, mean=0.001),), {}, "departs from the prediction by 6.5 µm, root mean square"),
        ((replace(BAD, side=""),), {}, "departs from"),
    ):
        assert words in verdict(condition(*regions), **options).text
    long = condition(FINE, length=0.05)
    text = "The model does not explain the observation: s²ℓ of the residuals is 4.9 times that of the stated noise; "
    assert verdict(long, p=0.04) == FitVerdict(text + END, flagged=True)
    assert "observation (p = 0.004): s²ℓ of the residuals is 4.9 times" in verdict(long, p=0.001).text


def test_the_limits() -> None:
    """The least p-value counts four times; s²ℓ is 4.9 times the stated one for 0.05 mm, 2.9 times for 0.03 mm."""
    for p, d, waves, length, flagged in (
        (0.0026, 0.5, 0.5, 0.02, False),
        (0.0024, 0.5, 0.5, 0.02, True),
        (0.5, 0.0024, 0.5, 0.02, True),
        (0.5, 0.5, 0.0026, 0.02, False),
        (0.5, 0.5, 0.0024, 0.02, True),
        (0.04, 0.5, 0.5, 0.05, True),
        (0.04, 0.5, 0.5, 0.03, False),
    ):
        found = verdict(condition(FINE, length=length), p=p, d=d, waves=waves)
        assert found.flagged == flagged, (p, d, waves, length)
        assert ("vary slowly along the observed interface" in found.text) == (flagged and waves < 0.01)


def test_noise_that_was_fitted_to_the_residuals_explains_them_unless_they_are_smooth() -> None:
    """Of an interface 1 mm long; planted: an error of the model, which the noise takes up if it may."""
    line = Interface.polyline(np.stack([np.linspace(0.0, 1.0, 201), np.zeros(201)], axis=1))
    for length in (0.07, 0.1):
        found = with_fitted_noise(verdict(condition(FINE)), [Observation(line, PointErrors(0.0021, length))])
        fitted = f"with noise fitted to its residuals: sd 2.1 µm, correlated over {1e3 * length:.0f} µm."
        assert found.flagged == (length == 0.1)
        assert found.text.startswith(f"{EXPLAINED}, {fitted} An error of the model") != found.flagged
    assert "smooth over 100 µm, as errors of a model are" in found.text


FAR = (
    ({"shift": 0.005}, {"shift": (0.03, 0.04)}, "shifted by 50 µm, 10 times the stated 5 µm"),
    ({"offset": 0.002, "shift": 0.005}, {"shift": (0.02, 0.0), "offset": (-0.012,)}, "moved along its normals by"),
)
UNLIKELY = (
    ({"rotation": 1.0}, {"rotation": (-2.1,)}, "turned by 2.1°, 2.1 times the stated rotation of 1°: measure"),
    ({"shift": 0.01}, {"shift": (0.02, 0.015)}, "shifted by 25 µm, 2.5 times the stated shift of 10 µm: measure"),
    ({"shift": 0.01}, {"shift": (0.022, 0.0)}, ""),  # of two components, not yet unlikely
)


def test_a_position_that_is_far_from_the_stated_one_is_flagged_and_an_unlikely_one_is_a_warning() -> None:
    """The residuals are noise: the errors of the whole interface have been removed from them."""

    def strained(stated: dict[str, float], removed: dict[str, tuple[float, ...]]) -> Any:
        return replace(condition(FINE), stated=StatedErrors(PointErrors(0.001, **stated), False), removed=removed)

    for stated, removed, words in FAR:
        found = verdict(strained(stated, removed))
        assert found.flagged
        assert f"the observed interface of condition V50 would have to be {words}" in found.text
        near = {name: tuple(0.4 * one for one in sizes) for name, sizes in removed.items()}
        assert not verdict(strained(stated, near)).flagged
        assert not verdict(strained(stated, removed), run_alone=True).flagged
    for stated, removed, words in UNLIKELY:
        one = strained(stated, removed)
        lines = list(unlikely_errors(Misfit("", flagged=False, conditions=(one,))))
        assert len(lines) == bool(words)
        assert all(f"The observed interface of condition V50 fits best if it is {words}" in line for line in lines)
        assert not verdict(one).flagged


def test_a_range_that_holds_the_noise_back_is_reported() -> None:
    for sd, length, words in (
        (0.1001, 0.02, "sd of the noise lies at the lower end of its range, 100 µm"),
        (0.15, 0.05, "correlation length of the noise lies at the upper end of its range, 50 µm"),
        (0.15, 0.02, ""),
    ):
        found = list(noise_at_an_end({"sd": sd, "length": length}, UnknownErrors((0.1, 0.2), (0.01, 0.05))))
        assert [f"The inferred {words}" in one for one in found] == [True] * bool(words)


def test_the_summary_holds_the_numbers_in_micrometres() -> None:
    """Nothing in the box comes near: that is the verdict, then."""
    sizes = {"shift": (0.004, -0.006), "rotation": (0.5,), "scale": (0.002,), "offset": (-0.001,)}
    content: Any = fit_as_json(misfit(replace(condition(FINE, BAD), removed=sizes)), None)
    assert content == json.loads(json.dumps(content))
    assert (content["flagged"], content["p"], content["region_p"], content["smooth_p"]) == (True, 0.43, 0.0004, 0.2)
    (one,) = content["conditions"]
    found = [one["length_um"], one["stated_sd_um"], one["ratio"], one["regions"][1]["mean_um"]]
    assert found == pytest.approx([20.0, 1.0, 1.96, 6.0])
    assert one["removed"].pop("shift_um") == pytest.approx([4.0, -6.0])
    assert one["removed"] == pytest.approx({"rotation_deg": 0.5, "scale": 0.002, "offset_um": -1.0})
    far = "NOTHING IN THE BOX COMES NEAR the observation"
    content = fit_as_json(misfit(condition(FINE)), far)
    assert (content["flagged"], content["verdict"]) == (True, far)


X = np.linspace(0.0, 1.0, 33)
HEIGHTS = np.linspace(0.1, 0.3, 21)


def arch(height: float, *, scale: float = 1.0, shift: float = 0.0) -> Interface:
    return Interface.polyline(scale * np.stack([X, height * np.sin(np.pi * X)], axis=1) + np.array([shift, 0.0]))


def nearest(seen: Interface, measure: Any, variance: float, *, every: int = 1, scale: float = 1.0) -> Nearest:
    """Return what is said of arches of these heights, `scale` times too large, beside the observed one."""
    heights, observations = HEIGHTS[::every].tolist(), (Observation(seen, variance),)
    records = [RunRecord(f"k{h}", {"h": h}, "ok", {"": arch(h, scale=scale)}) for h in heights]
    likelihood = InterfaceLikelihood(observations, measure)
    space = ParameterSpace((Parameter("h", Uniform(0.1, 0.3)),))
    problem = Problem(lambda *_: Simulation.of(arch(0.1)), space, {}, observations, {"m": measure})
    (found,) = nearest_runs(problem, records, np.array([likelihood(record.interfaces) for record in records]))
    return found


MEASURES = {
    "tracked_points": ({}, 1e-6),
    "measurement_lines": ({"lines": 10}, 1e-6),
    "closest_point": ({"direction": "to_simulated", "weighting": "length"}, 1e-6),
    "currents": ({"width": 0.02}, 1e-5),
}


@pytest.mark.parametrize("name", MEASURES)
def test_planted_misfits_are_noticed_and_sound_studies_are_not_suspected(name: str) -> None:
    """The best of six runs with little noise is many noise units off, yet the observation lies between two of them."""
    options, variance = MEASURES[name]
    measure = DISCREPANCIES[name](**options)
    sound = nearest(arch(0.2234), measure, variance)
    assert (sound.near, nothing_near([sound]), sound.extent_ratio) == (True, None, pytest.approx(1.0))
    few = nearest(arch(0.2234), measure, 1e-4 * variance, every=4)
    assert (few.residual > 5.0, few.near) == (True, True)
    units = nearest(arch(0.2), measure, variance, scale=1e3)
    assert "µm and mm differ by a factor of 1000" in units.message
    away = nearest(arch(0.2, shift=500.0), measure, variance)
    assert "NOTHING IN THE BOX COMES NEAR the observation: the best run (h = " in away.message
    assert "Their centres lie 500 mm apart" in away.message
    turned = nearest(Interface.polyline(arch(0.2).points[:, ::-1]), measure, variance)
    assert re.search(r"With x and y exchanged it would lie 0\.\d+ mm away, not 0\.\d+ mm", turned.message)
    outside = nearest(arch(0.6), measure, variance)
    assert outside.inputs["h"] == 0.3
    assert outside.axes == ""
    assert not any(one.near for one in (units, away, turned, outside))


def test_a_norm_that_no_longer_grows_does_not_hide_the_distance() -> None:
    """With so much noise d² never exceeds 25 σ_N², however far the observation."""
    found = nearest(arch(0.2, shift=500.0), DISCREPANCIES["currents"](width=0.02), 0.02)
    assert (found.residual < 5.0, found.near) == (True, False)
