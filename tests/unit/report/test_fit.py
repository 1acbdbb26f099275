"""What is said of a model that fits, of one that does not, and of all between."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.unit.report.fits import BAD, FINE, condition, misfit, verdict

from strandline.calibration import Misfit
from strandline.calibration.misfit import unlikely_errors
from strandline.calibration.misfit.verdict import Verdict, with_fitted_noise
from strandline.interface import Interface, Observation, PointErrors, UnknownErrors
from strandline.likelihood.residual_noise import StatedErrors
from strandline.report.fit import fit_as_json
from strandline.report.warnings import noise_at_an_end


def test_a_model_that_fits() -> None:
    """A small p-value of some part is not hidden by that of all."""
    assert verdict(condition(FINE)) == Verdict("The model explains the observation: p = 0.43.", flagged=False)
    both = verdict(condition(FINE), condition(FINE, name="V100"))
    assert both.text.startswith("The model explains the observations: ")
    found = verdict(condition(FINE), waves=0.006)
    said = "p = 0.43, but look at the residuals: 4 times the smallest p-value is 0.024."
    assert found == Verdict(f"The model explains the observation: {said}", flagged=False)


def test_a_model_that_does_not_fit_and_where() -> None:
    found = verdict(condition(FINE, BAD), p=0.004)
    assert found.flagged
    assert found.text == (
        "The model does not explain the observation (p = 0.0016): near s = 0.9–1.1 mm of condition V50 the observed "
        "interface lies 6 µm above the prediction (towards larger y), 5.2 times the standard deviation of that mean; "
        "trust neither mean nor width of the posterior."
    )
    everywhere = (replace(BAD, begin=0.0, end=0.4, p_value=0.002), BAD)
    for regions, options, words in (
        ((FINE, BAD), {"waves": 1e-5}, "(p < 0.001 over the whole interface): near s = 0.9–1.1 mm"),
        (everywhere, {"p": 0.004}, ": everywhere, most near s = 0.9–1.1 mm of"),
        ((replace(BAD, mean=0.001),), {}, "departs from the prediction by 6.5 µm, root mean square"),
        ((replace(BAD, side=""),), {}, "departs from"),
    ):
        assert words in verdict(condition(*regions), **options).text


def test_only_the_reason_is_given() -> None:
    """A corrected p-value that is not small is no reason; residuals that are long are."""
    long = condition(FINE, length=0.05)
    text = "The model does not explain the observation: s²ℓ of the residuals is 4.9 times that of the stated noise; "
    end = "trust neither mean nor width of the posterior."
    assert verdict(long, p=0.04) == Verdict(text + end, flagged=True)
    assert "observation (p = 0.004): s²ℓ of the residuals is 4.9 times" in verdict(long, p=0.001).text
    assert "near s" not in verdict(condition(replace(FINE, p_value=0.04), length=0.05), p=0.04).text


def test_a_single_run_proves_nothing() -> None:
    found = verdict(condition(BAD), run_alone=True)
    assert not found.flagged
    assert found.text.startswith("The best run does not explain the observation (p = 0.0016): near s = 0.9–1.1 mm")
    assert found.text.endswith(", but no surrogate could be built to check the inputs between the runs.")
    assert verdict(condition(FINE), run_alone=True).text.startswith("The model explains")


def test_the_limits() -> None:
    """The least p-value counts four times; s²ℓ is 4.9 times the stated one for 0.05 mm, 2.9 times for 0.03 mm."""
    for p, d, waves, length, flagged in (
        (0.0026, 0.5, 0.5, 0.02, False),
        (0.0024, 0.5, 0.5, 0.02, True),
        (0.5, 0.0024, 0.5, 0.02, True),
        (0.5, 0.5, 0.0026, 0.02, False),
        (0.5, 0.5, 0.0024, 0.02, True),
        (0.04, 0.5, 0.5, 0.05, True),
        (0.06, 0.5, 0.5, 0.05, False),
        (0.04, 0.5, 0.5, 0.03, False),
    ):
        found = verdict(condition(FINE, length=length), p=p, d=d, waves=waves)
        assert found.flagged == flagged, (p, d, waves, length)
        assert ("vary slowly along the observed interface" in found.text) == (flagged and waves < 0.01)
        assert ("s²ℓ of the residuals is 4.9 times" in found.text) == (flagged and length == 0.05)


def test_noise_that_was_fitted_to_the_residuals_explains_them_unless_they_are_smooth() -> None:
    """Of an interface 1 mm long; planted: an error of the model, which the noise takes up if it may."""
    line = Interface.polyline(np.stack([np.linspace(0.0, 1.0, 201), np.zeros(201)], axis=1))
    right = Verdict("The model explains the observation: p = 0.43.", flagged=False)
    for length in (0.05, 0.07):
        found = with_fitted_noise(right, [Observation(line, PointErrors(0.0021, length))])
        fitted = f"with noise fitted to its residuals: sd 2.1 µm, correlated over {1e3 * length:.0f} µm."
        assert not found.flagged
        assert found.text.startswith(f"The model explains the observation: p = 0.43, {fitted} An error of the model")
    found = with_fitted_noise(right, [Observation(line, PointErrors(0.0021, 0.1))])
    assert found.flagged
    assert "smooth over 100 µm, as errors of a model are" in found.text
    assert found.text.endswith("trust neither mean nor width of the posterior.")


def strained(stated: dict[str, float], removed: dict[str, tuple[float, ...]]) -> Any:
    """Return residuals that are noise: the errors of the whole interface have been removed from them."""
    return replace(condition(FINE), stated=StatedErrors(PointErrors(0.001, **stated), assumed=False), removed=removed)


def test_a_position_that_is_far_from_the_stated_one_is_flagged() -> None:
    cases: list[tuple[dict[str, float], dict[str, tuple[float, ...]], str]] = [
        ({"shift": 0.005}, {"shift": (0.03, 0.04)}, "shifted by 50 µm, 10 times the stated 5 µm"),
        ({"rotation": 0.5}, {"rotation": (-2.5,)}, "turned by 2.5°, 5 times the stated 0.5°"),
        ({"scale": 0.005}, {"scale": (0.03,)}, "scaled by 3 %, 6 times the stated 0.5 %"),
        ({"offset": 0.002, "shift": 0.005}, {"shift": (0.02, 0.0), "offset": (-0.012,)}, "moved along its normals by"),
    ]
    for stated, removed, words in cases:
        found = verdict(strained(stated, removed))
        assert found.flagged
        assert f"the observed interface of condition V50 would have to be {words}" in found.text
        near = {name: tuple(0.4 * one for one in sizes) for name, sizes in removed.items()}
        assert not verdict(strained(stated, near)).flagged
        assert not verdict(strained(stated, removed), run_alone=True).flagged


def test_a_position_that_is_unlikely_is_a_warning() -> None:
    """Of two components, 2.2 standard deviations are not yet unlikely."""
    cases: list[tuple[dict[str, float], dict[str, tuple[float, ...]], str]] = [
        ({"rotation": 1.0}, {"rotation": (-2.1,)}, "turned by 2.1°, 2.1 times the stated rotation of 1°: measure"),
        ({"shift": 0.01}, {"shift": (0.02, 0.015)}, "shifted by 25 µm, 2.5 times the stated shift of 10 µm: measure"),
        ({"scale": 0.005}, {"scale": (0.0099,)}, "scaled by 0.99 %, 2 times the stated scale of 0.5 %: measure"),
        ({"rotation": 1.0}, {"rotation": (-1.9,)}, ""),
        ({"shift": 0.01}, {"shift": (0.022, 0.0)}, ""),
    ]
    for stated, removed, words in cases:
        one = strained(stated, removed)
        found = list(unlikely_errors(Misfit("", flagged=False, conditions=(one,))))
        assert len(found) == bool(words)
        assert all(f"The observed interface of condition V50 fits best if it is {words}" in line for line in found)
        assert not verdict(one).flagged


def test_a_range_that_holds_the_noise_back_is_reported() -> None:
    for sd, length, words in (
        (0.1001, 0.02, "The inferred sd of the noise lies at the lower end of its range, 100 µm"),
        (0.199, 0.02, "The inferred sd of the noise lies at the upper end of its range, 200 µm"),
        (0.15, 0.05, "The inferred correlation length of the noise lies at the upper end of its range, 50 µm"),
        (0.15, 0.02, ""),
    ):
        found = list(noise_at_an_end({"sd": sd, "length": length}, UnknownErrors((0.1, 0.2), (0.01, 0.05))))
        assert [one[: len(words)] for one in found] == ([words] if words else [])
        assert not list(noise_at_an_end({"sd": sd, "length": length}, UnknownErrors(None, 0.05)))


def test_the_summary_holds_the_numbers_in_micrometres() -> None:
    """Nothing in the box comes near: that is the verdict, then."""
    sizes = {"shift": (0.004, -0.006), "rotation": (0.5,), "scale": (0.002,), "offset": (-0.001,)}
    content = fit_as_json(misfit(replace(condition(FINE, BAD), removed=sizes)), None)
    assert content is not None
    assert content == json.loads(json.dumps(content))
    assert (content["flagged"], content["p"], content["region_p"], content["smooth_p"]) == (True, 0.43, 0.0004, 0.2)
    (one,) = content["conditions"]
    found = [one["length_um"], one["stated_sd_um"], one["ratio"], one["regions"][1]["mean_um"]]
    assert found == pytest.approx([20.0, 1.0, 1.96, 6.0])
    assert one["removed"].pop("shift_um") == pytest.approx([4.0, -6.0])
    assert one["removed"] == pytest.approx({"rotation_deg": 0.5, "scale": 0.002, "offset_um": -1.0})
    far = "NOTHING IN THE BOX COMES NEAR the observation"
    content = fit_as_json(misfit(condition(FINE)), far)
    assert content is not None
    assert (content["flagged"], content["verdict"]) == (True, far)
    assert content["conditions"][0]["removed"] == {}
    assert fit_as_json(None, far) is None
