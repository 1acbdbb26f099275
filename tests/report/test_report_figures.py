"""What the figures and the page of a report owe to print, to small and dark screens, and to a posterior in doubt."""

import re
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from strandline.interface import Interface, Observation, PointErrors, UnknownErrors
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Offsets
from strandline.priors import Uniform
from strandline.report import page as pages
from strandline.report.captioned import Captioned, whole
from strandline.report.field_figures import _as_stated as as_stated
from strandline.report.page import _marked, _saved, _unbroken
from strandline.report.plots import plot_run_offsets, plot_tempering
from strandline.report.plots.style import DOTS_PER_INCH, DOUBLE, SINGLE
from strandline.report.run_figures import failed_runs, offsets_of_runs
from strandline.report.warnings import LOO_LIMIT, reason_to_doubt

CSS = (Path(pages.__file__).parent / "templates" / "style.css").read_text()


def sure(calibration: Any, error: float = 0.1) -> Any:
    surrogate = calibration.surrogate
    validation = replace(surrogate.validation, loo_rms_near_mode=error)
    return replace(calibration, surrogates={"tracked_points": replace(surrogate, validation=validation)})


def test_reasons_to_doubt(reported: Any) -> None:
    good = sure(reported.outcome.calibration)
    assert reason_to_doubt(good) is None
    assert reason_to_doubt(good, {"verdict": "good"}) is None
    assert "check with the true model" in str(reason_to_doubt(good, {"verdict": "bad"}))
    assert "leave-one-out error near the mode 0.9" in str(reason_to_doubt(sure(good, LOO_LIMIT + 0.4)))
    assert good.misfit is not None
    wrong = replace(good, misfit=replace(good.misfit, flagged=True))
    assert reason_to_doubt(wrong) == "the model does not explain what was observed"
    high = replace(good.posterior, log_likelihood=good.posterior.log_likelihood + 50.0)
    assert "above 0" in str(reason_to_doubt(replace(good, posterior=high)))


def test_a_prediction_says_what_the_whole_outline_may_still_do() -> None:
    """The figure shows the observed interface as measured; a caption without that would blame the model."""
    line = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]))
    assert as_stated(Observation(line, PointErrors(0.01, length=0.1))) == ""
    assert "its unknown shift can" in as_stated(Observation(line, PointErrors(0.01, shift=0.1)))
    assert "its unknown rotation and scale can" in as_stated(Observation(line, UnknownErrors(rotation=1.0, scale=0.01)))


@pytest.mark.parametrize(
    ("name", "section", "marked"),
    [
        ("marginals", "posterior", True),
        ("cut_marginals", "uncertainty", True),
        ("predictive_slow", "certificate", True),
        ("run_history", "certificate", False),
        ("interfaces", "data", False),
    ],
)
def test_the_mark_is_on_figures_of_the_posterior(name: str, section: str, marked: bool) -> None:
    figure: Any = plot_tempering([1.0], [10.0], [0.3])
    shown = _marked(Captioned(name, section, "", figure), "not converged")
    assert bool(shown.figure.get_suptitle()) == marked
    assert not _marked(Captioned(name, section, "", plot_tempering([1.0], [9.0], [0.3])), None).figure.get_suptitle()


def test_pictures_are_as_wide_as_columns(reported: Any) -> None:
    pictures = list((reported.folder / "figures").glob("*.png"))
    assert pictures
    for path in pictures:
        assert inches(path, pages.DOTS_PER_INCH) in (pytest.approx(SINGLE, abs=0.04), pytest.approx(DOUBLE, abs=0.04))


def test_pictures_have_300_dots_an_inch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests draw them with fewer."""
    assert DOTS_PER_INCH == 300
    monkeypatch.setattr(pages, "DOTS_PER_INCH", DOTS_PER_INCH)
    _saved(Captioned("tempering", "sampler", "", plot_tempering([1.0], [9.0], [0.3])), tmp_path)
    assert inches(tmp_path / "tempering.png", 300) in (
        pytest.approx(SINGLE, abs=0.01),
        pytest.approx(DOUBLE, abs=0.01),
    )


def test_axis_labels_lie_on_the_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of tick labels, and so their width, depends on the font size at the moment of drawing."""
    monkeypatch.setattr(pages, "DOTS_PER_INCH", DOTS_PER_INCH)
    s = np.linspace(0.0, 1.45, 60)
    some = Offsets(s, 1e-3 * np.where(s < 0.7, 2.18, 1.18) * np.sin(4.4 * s))
    axes = plot_run_offsets(some, {f"{k} best run, log-likelihood −1.048": some for k in ("second", "third", "fourth")})
    _saved(Captioned("offsets", "data", "", whole(axes.figure)), tmp_path)
    columns = imread(tmp_path / "offsets.png")[..., :3].min(axis=(0, 2))
    assert columns[:5].min() == 1.0, "the label at the left is cut off"


def inches(picture: Path, dots: int) -> float:
    width, _ = struct.unpack(">II", picture.read_bytes()[16:24])
    return float(width / dots)


def test_no_picture_of_the_report_embeds_type_3_fonts(reported: Any) -> None:
    pictures = list((reported.folder / "figures").glob("*.pdf"))
    assert pictures
    assert all(b"/Type3" not in path.read_bytes() for path in pictures)


def test_the_offsets_of_the_best_runs_and_of_the_observation(reported: Any) -> None:
    calibration = reported.outcome.calibration
    (shown,) = offsets_of_runs(calibration)
    assert (shown.name, shown.section) == ("offsets", "data")
    (ax,) = shown.figure.axes
    labels = [str(line.get_label()) for line in ax.lines]
    assert labels[-2:] == ["best run", "observed"]
    assert len(labels) == 6


def test_failed_runs_of_three_inputs_have_a_picture(reported: Any) -> None:
    calibration = reported.outcome.calibration
    space = ParameterSpace((*calibration.problem.space, Parameter("load", Uniform(0.0, 2e-5), "N/m")))
    records = [replace(r, state="failed", failure_kind="stalled", interfaces={}) for r in calibration.records[:3]]
    broken = replace(
        calibration,
        problem=replace(calibration.problem, space=space),
        records=(*records, *calibration.records[3:]),
    )
    (shown,) = failed_runs(broken)
    assert (shown.name, shown.section) == ("failed_runs", "runs")
    labels = [text.get_text() for text in shown.figure.axes[0].get_legend().get_texts()]
    assert labels == ["ok: 61", "stalled: 3"]
    assert not list(failed_runs(replace(calibration, records=broken.records))), "two inputs have theirs in the maps"
    assert not list(failed_runs(replace(broken, records=calibration.records[3:])))


@pytest.mark.parametrize(
    ("text", "shown"), [("-0.8", "−0.8"), ("5e-05", "5·10⁻⁵"), ("1.2e+06", "1.2·10⁶"), ("nan", "nan")]
)
def test_no_number_breaks_over_lines(text: str, shown: str) -> None:
    assert _unbroken(text).replace("\u00a0", "") == shown
    assert not re.search("[ -]", _unbroken(text))


def test_symbols_and_units_of_the_inputs(reported: Any) -> None:
    summary = reported.outcome.summary
    inputs = {name: item | {"label": f"{name}_x", "unit": "mm^2/s"} for name, item in summary["inputs"].items()}
    text = pages.template("report.html.j2").render(
        s=summary | {"inputs": inputs}, figures=[], study_text="", check=None
    )
    assert text.count("E<sub>x</sub>") >= 2
    assert "mm²\u00a0s⁻¹" in text
    assert "mm^2/s" not in text


def test_the_posterior_is_a_list_on_a_narrow_screen(reported: Any) -> None:
    text = reported.outcome.report.read_text()
    table = text[text.index('<table class="cards">') :]
    labels = re.findall('data-label="([^"]*)"', table[: table.index("</table>")])
    assert labels[:8] == ["unit", "mean", "sd", "median", "5 %", "95 %", "MAP", "truth"]
    narrow = CSS[CSS.index("@media (max-width: 600px)") :]
    assert "content: attr(data-label)" in narrow


def test_print_and_dark_styles() -> None:
    printed = CSS[CSS.index("@media print") :]
    assert "white-space: pre-wrap" in printed
    assert "max-height" in printed
    dark = CSS[CSS.index("prefers-color-scheme: dark") : CSS.index("* { box-sizing")]
    light = set(re.findall(r"(--\w+):", CSS[: CSS.index("@media")]))
    assert light <= set(re.findall(r"(--\w+):", dark))
    assert "figure img { background: #fff" in dark
    assert np.all([color.startswith("var(") or color == "#fff" for color in re.findall(r"background: ([^;]+);", CSS)])
