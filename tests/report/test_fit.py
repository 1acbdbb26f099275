"""The report says first whether the model fits: in a section, in the summary, and in its first line if it does not."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from strandline.calibration import Calibration, Misfit
from strandline.calibration.misfit import ConditionMisfit, Region, unlikely_errors
from strandline.calibration.misfit.verdict import Verdict, verdict_on, with_fitted_noise
from strandline.interface import Interface, Observation, PointErrors, UnknownErrors
from strandline.likelihood.residual_noise import ResidualNoise, StatedErrors
from strandline.report import page
from strandline.report.fit import fit_as_json, fit_figures
from strandline.report.page import template
from strandline.report.warnings import find_warnings, noise_at_an_end

ARC = np.linspace(0.0, 1.2, 31)
BAD = Region(0.9, 1.1, 0.006, 0.0065, "above", 5.2, 0.0004)
FINE = Region(0.0, 0.9, 0.0001, 0.001, "below", 0.4, 1.0)
FAR = "NOTHING IN THE BOX COMES NEAR the observation"


def condition(*regions: Region, name: str = "V50", length: float = 0.02, line: bool = True) -> ConditionMisfit:
    return ConditionMisfit(
        condition=name,
        arc_length=ARC,
        residual=0.002 * np.sin(9 * ARC),
        stated=StatedErrors(PointErrors(0.001), assumed=False),
        expected=ResidualNoise(0.001, 0.02),
        found=ResidualNoise(0.0014, length),
        p_value=0.3,
        predictive_p=0.4,
        regions=regions,
        surface=not line,
    )


def verdict(
    *conditions: ConditionMisfit, p: float = 0.43, d: float = 0.5, waves: float = 0.5, run_alone: bool = False
) -> Verdict:
    return verdict_on(p, d, waves, conditions, run_alone=run_alone)


def misfit(*conditions: ConditionMisfit, p: float = 0.43) -> Misfit:
    said = verdict(*conditions, p=p)
    return Misfit(said.text, said.flagged, p, 0.5, 0.2, conditions, ("The interface was predicted by a spell.",))


def test_a_model_that_fits() -> None:
    assert verdict(condition(FINE)) == Verdict("The model explains the observation: p = 0.43.", flagged=False)
    both = verdict(condition(FINE), condition(FINE, name="V100"))
    assert both.text.startswith("The model explains the observations: ")


def test_a_small_p_value_of_some_part_is_not_hidden_by_that_of_all() -> None:
    found = verdict(condition(FINE), waves=0.006)
    assert not found.flagged
    said = "p = 0.43, but look at the residuals: 4 times the smallest p-value is 0.024."
    assert found.text == f"The model explains the observation: {said}"


def test_a_model_that_does_not() -> None:
    found = verdict(condition(FINE, BAD), p=0.004)
    assert found.flagged
    assert found.text == (
        "The model does not explain the observation (p = 0.0016): near s = 0.9–1.1 mm of condition V50 the observed "
        "interface lies 6 µm above the prediction (towards larger y), 5.2 times the standard deviation of that mean; "
        "trust neither mean nor width of the posterior."
    )


def test_a_place_that_another_test_found_says_so() -> None:
    found = verdict(condition(FINE, BAD), waves=1e-5)
    assert "(p < 0.001 over the whole interface): near s = 0.9–1.1 mm" in found.text
    assert "over the whole" not in verdict(condition(FINE, BAD), p=0.004).text


@pytest.mark.parametrize(("length", "smooth"), [(0.05, False), (0.07, False), (0.1, True)])
def test_noise_that_was_fitted_to_the_residuals_explains_them_unless_they_are_smooth(
    length: float, smooth: bool
) -> None:
    """Of an interface 1 mm long; planted: an error of the model, which the noise takes up if it may."""
    line = Interface.polyline(np.stack([np.linspace(0.0, 1.0, 201), np.zeros(201)], axis=1))
    right = Verdict("The model explains the observation: p = 0.43.", flagged=False)
    found = with_fitted_noise(right, [Observation(line, PointErrors(0.0021, length))])
    assert found.flagged == smooth
    if smooth:
        assert "smooth over 100 µm, as errors of a model are" in found.text
        assert found.text.endswith("trust neither mean nor width of the posterior.")
    else:
        fitted = f"with noise fitted to its residuals: sd 2.1 µm, correlated over {1e3 * length:.0f} µm."
        assert found.text.startswith(f"The model explains the observation: p = 0.43, {fitted} An error of the model")


@pytest.mark.parametrize(
    ("stated", "removed", "words"),
    [
        ({"shift": 0.005}, {"shift": (0.03, 0.04)}, "shifted by 50 µm, 10 times the stated 5 µm"),
        ({"rotation": 0.5}, {"rotation": (-2.5,)}, "turned by 2.5°, 5 times the stated 0.5°"),
        ({"scale": 0.005}, {"scale": (0.03,)}, "scaled by 3 %, 6 times the stated 0.5 %"),
        ({"offset": 0.002, "shift": 0.005}, {"shift": (0.02, 0.0), "offset": (-0.012,)}, "moved along its normals by"),
    ],
)
def test_a_position_that_is_far_from_the_stated_one_is_flagged(
    stated: dict[str, float], removed: dict[str, tuple[float, ...]], words: str
) -> None:
    """Its residuals are noise: the shift has been removed from them."""
    strained = replace(condition(FINE), stated=StatedErrors(PointErrors(0.001, **stated), assumed=False))
    found = verdict(replace(strained, removed=removed))
    assert found.flagged
    assert f"the observed interface of condition V50 would have to be {words}" in found.text
    near = {name: tuple(0.4 * one for one in sizes) for name, sizes in removed.items()}
    assert not verdict(replace(strained, removed=near)).flagged
    assert not verdict(replace(strained, removed=removed), run_alone=True).flagged


@pytest.mark.parametrize(
    ("stated", "removed", "words"),
    [
        (
            {"rotation": 1.0},
            {"rotation": (-2.1,)},
            "turned by 2.1°, 2.1 times the stated rotation of 1°: measure",
        ),
        (
            {"shift": 0.01},
            {"shift": (0.02, 0.015)},
            "shifted by 25 µm, 2.5 times the stated shift of 10 µm: measure",
        ),
        (
            {"scale": 0.005},
            {"scale": (0.0099,)},
            "scaled by 0.99 %, 2 times the stated scale of 0.5 %: measure",
        ),
        ({"rotation": 1.0}, {"rotation": (-1.9,)}, None),
        ({"shift": 0.01}, {"shift": (0.022, 0.0)}, None),  # of two components, 2.2 sd are not yet unlikely
    ],
)
def test_a_position_that_is_unlikely_is_a_warning(
    stated: dict[str, float], removed: dict[str, tuple[float, ...]], words: str | None
) -> None:
    strained = replace(condition(FINE), stated=StatedErrors(PointErrors(0.001, **stated), assumed=False))
    found = list(unlikely_errors(Misfit("", flagged=False, conditions=(replace(strained, removed=removed),))))
    assert len(found) == (words is not None)
    assert words is None or f"The observed interface of condition V50 fits best if it is {words}" in found[0]
    assert not verdict(replace(strained, removed=removed)).flagged


@pytest.mark.parametrize(
    ("sd", "length", "words"),
    [
        (0.1001, 0.02, "The inferred sd of the noise lies at the lower end of its range, 100 µm"),
        (0.199, 0.02, "The inferred sd of the noise lies at the upper end of its range, 200 µm"),
        (0.15, 0.05, "The inferred correlation length of the noise lies at the upper end of its range, 50 µm"),
        (0.15, 0.02, ""),
    ],
)
def test_a_range_that_holds_the_noise_back_is_reported(sd: float, length: float, words: str) -> None:
    found = list(noise_at_an_end({"sd": sd, "length": length}, UnknownErrors((0.1, 0.2), (0.01, 0.05))))
    assert [one[: len(words)] for one in found] == ([words] if words else [])
    assert not list(noise_at_an_end({"sd": sd, "length": length}, UnknownErrors(None, 0.05)))


def test_a_model_that_is_wrong_everywhere() -> None:
    parts = (replace(BAD, begin=0.0, end=0.4, p_value=0.002), BAD)
    assert ": everywhere, most near s = 0.9–1.1 mm of" in verdict(condition(*parts), p=0.004).text


def test_residuals_of_both_signs_depart() -> None:
    waves = replace(BAD, mean=0.001)
    assert "departs from the prediction by 6.5 µm, root mean square" in verdict(condition(waves)).text
    assert "departs from" in verdict(condition(replace(BAD, side=""))).text


@pytest.mark.parametrize(
    ("p", "d", "waves", "length", "flagged"),
    [
        (0.0026, 0.5, 0.5, 0.02, False),
        (0.0024, 0.5, 0.5, 0.02, True),
        (0.5, 0.0024, 0.5, 0.02, True),
        (0.5, 0.5, 0.0026, 0.02, False),
        (0.5, 0.5, 0.0024, 0.02, True),
        (0.04, 0.5, 0.5, 0.05, True),
        (0.06, 0.5, 0.5, 0.05, False),
        (0.04, 0.5, 0.5, 0.03, False),
    ],
    ids=[
        "likely enough",
        "unlikely",
        "unlikely d²",
        "likely waves",
        "unlikely waves",
        "long and doubtful",
        "long",
        "doubtful",
    ],
)
def test_the_limits(p: float, d: float, waves: float, length: float, flagged: bool) -> None:
    """The least p-value counts four times; s²ℓ is 4.9 times the stated one for 0.05 mm, 2.9 times for 0.03 mm."""
    found = verdict(condition(FINE, length=length), p=p, d=d, waves=waves)
    assert found.flagged == flagged
    assert ("vary slowly along the observed interface" in found.text) == (flagged and waves < 0.01)
    assert ("s²ℓ of the residuals is 4.9 times" in found.text) == (flagged and length == 0.05)


def test_only_the_reason_is_given() -> None:
    """A corrected p-value that is not small is no reason; residuals that are long are."""
    found = verdict(condition(FINE, length=0.05), p=0.04)
    assert found == Verdict(
        "The model does not explain the observation: s²ℓ of the residuals is 4.9 times that of the stated noise; "
        "trust neither mean nor width of the posterior.",
        flagged=True,
    )
    both = verdict(condition(FINE, length=0.05), p=0.001)
    assert "observation (p = 0.004): s²ℓ of the residuals is 4.9 times" in both.text
    doubtful = replace(FINE, p_value=0.04)
    assert "near s" not in verdict(condition(doubtful, length=0.05), p=0.04).text


def test_a_single_run_proves_nothing() -> None:
    found = verdict(condition(BAD), run_alone=True)
    assert not found.flagged
    assert found.text.startswith("The best run does not explain the observation (p = 0.0016): near s = 0.9–1.1 mm")
    assert found.text.endswith(", but no surrogate could be built to check the inputs between the runs.")
    assert verdict(condition(FINE), run_alone=True).text.startswith("The model explains")


def test_the_summary_holds_the_numbers_in_micrometres() -> None:
    content = fit_as_json(misfit(condition(FINE, BAD)), None)
    assert content == json.loads(json.dumps(content))
    assert content is not None
    assert (content["flagged"], content["p"], content["region_p"]) == (True, 0.43, 0.0004)
    assert content["smooth_p"] == 0.2
    (one,) = content["conditions"]
    assert one["length_um"] == pytest.approx(20.0)
    assert one["stated_sd_um"] == pytest.approx(1.0)
    assert one["ratio"] == pytest.approx(1.96)
    assert one["regions"][1]["mean_um"] == pytest.approx(6.0)
    assert one["removed"] == {}


def test_the_summary_holds_the_global_errors_that_were_removed() -> None:
    sizes = {"shift": (0.004, -0.006), "rotation": (0.5,), "scale": (0.002,), "offset": (-0.001,)}
    content = fit_as_json(misfit(replace(condition(FINE), removed=sizes)), None)
    assert content is not None
    (one,) = content["conditions"]
    assert one["removed"].pop("shift_um") == pytest.approx([4.0, -6.0])
    assert one["removed"] == pytest.approx({"rotation_deg": 0.5, "scale": 0.002, "offset_um": -1.0})


def test_what_is_far_away_does_not_fit() -> None:
    content = fit_as_json(misfit(condition(FINE)), FAR)
    assert content is not None
    assert (content["flagged"], content["verdict"]) == (True, FAR)
    assert fit_as_json(None, FAR) is None


@pytest.fixture
def calibration(reported: Any) -> Calibration:
    found: Calibration = reported.outcome.calibration
    return found


def test_a_warning_is_the_verdict(calibration: Calibration) -> None:
    flagged = misfit(condition(BAD))
    remedy = " Find out what is wrong, or let the model err: `model_error: true` in `noise`."
    assert flagged.verdict + remedy in list(find_warnings(replace(calibration, misfit=flagged)))
    for fine in (misfit(condition(FINE)), None):
        assert not any("explain" in line for line in find_warnings(replace(calibration, misfit=fine)))


def test_a_figure_shows_the_residuals_of_each_condition(calibration: Calibration) -> None:
    found = misfit(condition(FINE, BAD), condition(FINE, name="V100"), condition(name="surface", line=False))
    (shown,) = fit_figures(replace(calibration, misfit=found))
    assert (shown.name, shown.section) == ("residuals", "fit")
    FigureCanvasAgg(shown.figure).draw()
    assert [ax.get_title() for ax in shown.figure.axes] == ["V50", "V100"]
    lines = {str(line.get_label()): line for line in shown.figure.axes[0].lines}
    np.testing.assert_allclose(lines["observed"].get_ydata(), 2.0 * np.sin(9 * ARC))
    labels = [text.get_text() for text in shown.figure.legends[0].get_texts()]
    assert "more than the noise allows" in labels
    assert not list(fit_figures(replace(calibration, misfit=misfit(condition(line=False)))))
    assert not list(fit_figures(replace(calibration, misfit=None)))


def rendered(reported: Any, found: Misfit | None) -> str:
    summary = {**reported.outcome.summary, "misfit": fit_as_json(found, None)}
    return str(template("report.html.j2").render(s=summary, figures=[], study_text="", check=None, picture=None))


def test_the_section_comes_before_the_posterior_and_its_verdict_first(reported: Any) -> None:
    text = rendered(reported, misfit(condition(FINE)))
    section = text[text.index("Does the model fit?</h2>") : text.index("The posterior</h2>")]
    assert section.split("</h2>")[1].lstrip().startswith('<p class="fine"><strong>The model explains the observation')
    assert "predicted by a spell" in section
    assert "1.96" not in section
    assert "<td>2</td>" in section
    assert '<p class="warnings"><strong>' not in text


def of_noise(reported: Any, stated: bool, sd: tuple[float, ...], length: tuple[float, ...], **others: Any) -> str:
    """Return the report on a study with this inferred noise: quantiles in µm."""
    levels = ("q05", "median", "q95")
    found = {name: dict(zip(levels, one, strict=True)) for name, one in (("sd_um", sd), ("length_um", length))}
    likelihood = {**reported.outcome.summary["likelihood"], "inferred_noise": {**found, "stated": stated, **others}}
    summary = {**reported.outcome.summary, "likelihood": likelihood}
    text = str(template("report.html.j2").render(s=summary, figures=[], study_text="", check=None, picture=None))
    return text.replace("&nbsp;", " ")


def test_noise_that_is_stated_has_no_quantiles(reported: Any) -> None:
    amplitude = {"q05": 1.0, "median": 2.31, "q95": 4.0}
    error = {"probability": 0.97, "amplitude_um": 2.04, "spread": 0.0, "amplitude_quantiles_um": amplitude}
    without = {"E": {"mean": 401.0, "sd": 2.0}}
    stated = {"model_error": error, "without_model_error": without}
    text = of_noise(reported, True, (3.0, 3.0, 3.0), (1e-9, 1e-9, 1e-9), **stated)
    assert "<p>Noise: standard deviation of a point 3 µm, correlation length 0 µm." in text
    assert "with probability 0.97; if it has one, this is a smooth offset of 2.31 µm (amplitude, median)." in text
    assert "It allows for model error. Without it: " in text


def test_the_evidence_says_which_constant_it_leaves_out(reported: Any) -> None:
    said = "additive constant differs from that of a study with stated noise"
    assert said in of_noise(reported, False, (2.0, 3.0, 4.0), (15.0, 15.0, 15.0))
    assert said not in (reported.folder / "report.html").read_text("utf-8")


def test_inferred_noise_has_quantiles(reported: Any) -> None:
    text = of_noise(reported, False, (2.0, 3.0, 4.0), (15.0, 15.0, 15.0))
    assert (
        "<p>The noise is inferred from the residuals (median, 5 % and 95 % quantile): standard deviation of a point "
        "3 (2 to 4) µm, correlation length 15 µm." in text
    )


def test_inferred_noise_stands_beside_what_was_stated(reported: Any) -> None:
    """A range and an unknown length; the error of the model has quantiles of its own."""
    prior = {"sd_um": [1.0, 10.0], "length_um": None}
    alone = of_noise(reported, False, (2.0, 3.0, 4.0), (10.0, 15.0, 21.0), prior=prior)
    row = '<td class="text">log-uniform from 1 to 10</td><td>3</td><td>2</td><td>4</td>'
    assert f"<tr><td>sd of a point</td>{row}</tr>" in alone
    assert '<td class="text">unknown: log-uniform over a wide range</td><td>15</td><td>10</td><td>21</td>' in alone
    assert "if there is one" not in alone
    ends = {"q05": 60.0, "median": 170.0, "q95": 600.0}
    error = {"probability": 0.9, "amplitude_um": 2.0, "spread": 0.0, "amplitude_quantiles_um": ends, "length_um": ends}
    both = {"sd_um": 3.0, "length_um": 0.0}
    text = of_noise(reported, True, (3.0, 3.0, 3.0), (1e-9, 1e-9, 1e-9), prior=both, model_error=error)
    assert '<td>sd of a point</td><td class="text">3, known</td><td>3</td>' in text
    assert '<td>correlation length</td><td class="text">0, known</td><td>0</td>' in text
    assert text.count("<td>170</td><td>60</td><td>600</td>") == 2
    assert "a smooth offset of 170 µm (amplitude, median)" in text


def test_the_report_says_how_each_picture_was_read(reported: Any) -> None:
    def page(*pictures: dict[str, Any]) -> str:
        summary = {**reported.outcome.summary, "pictures": list(pictures)}
        return str(template("report.html.j2").render(s=summary, figures=[], study_text="", check=None, picture=None))

    notes = ["pixel size 8 × 8 µm from the study", "its axes point y up (default)"]
    one = {"condition": "", "file": "drop.png", "sha256": "0123456789abcdef", "notes": notes}
    said = "pixel size 8 × 8 µm from the study; its axes point y up (default); sha256 0123456789ab…"
    assert f'<tr><td class="text">drop.png</td><td class="text">{said}</td></tr>' in page(one)
    assert "<td>slow</td>" in page(one, {**one, "condition": "slow"})
    assert "read as" not in page()


def test_every_part_of_the_arc_is_in_a_table_that_is_folded_if_it_is_long(reported: Any) -> None:
    text = rendered(reported, misfit(condition(FINE, BAD)))
    assert "<tr><td>0.9 – 1.1</td><td>6</td><td>6.5</td><td>5.2</td><td>0.0004</td></tr>" in text
    assert "<tr><td>0 – 0.9</td><td>0.1</td><td>1</td><td>0.4</td><td>1</td></tr>" in text
    assert "<details>" not in text
    many = rendered(reported, misfit(condition(*[FINE] * 6, BAD), condition(FINE, name="V100")))
    assert "<details>" in many
    assert "<td>V50</td><td>0.9 – 1.1</td>" in many
    assert "parts of the interface" not in rendered(reported, misfit(condition(line=False)))
    patch = replace(BAD, begin=0.0, end=0.0, centre=(0.81, 0.2, 0.05))
    surface = rendered(reported, misfit(condition(FINE, line=True), condition(patch, line=False)))
    assert "<td>(0.81, 0.2, 0.05)</td><td>6</td>" in surface


def test_the_first_line_says_that_it_does_not_fit(reported: Any) -> None:
    text = rendered(reported, misfit(condition(FINE, BAD)))
    after = text[text.index("</h1>") + 5 :].lstrip()
    assert after.startswith('<p class="warnings"><strong>The model does not explain the observation')


def test_a_page_without_the_section(reported: Any) -> None:
    text = rendered(reported, None)
    assert "Does the model fit?" not in text
    assert "#fit" not in text


def test_a_study_has_it_all(reported: Any) -> None:
    summary = reported.outcome.summary["misfit"]
    assert summary["flagged"] is False
    assert summary["p"] > 0.9
    assert summary["conditions"][0]["assumed"] is True
    assert len(summary["conditions"][0]["regions"]) == 4
    page = reported.outcome.report.read_text()
    assert page.index('id="fit"') < page.index('id="residuals"') < page.index('id="answer"')


def test_names_of_inputs_keep_their_capitals() -> None:
    """Jinja's `capitalize` makes all other letters small: E would become e."""
    folder = Path(page.__file__).parent / "templates"
    assert len(list(folder.glob("*.j2"))) > 1
    assert not [one.name for one in folder.glob("*.j2") if "capitalize" in one.read_text("utf-8")]
