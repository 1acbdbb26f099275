"""The report of a finished study: self-contained, whole, with every figure and number."""

import base64
import gzip
import math
import re
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from tests.study.conftest import Finished
from tests.study.report.pages import Page, rendered
from tests.unit.report.fits import BAD, FINE, condition, misfit

from strandline.interface import Interface
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import LogNormal, Uniform
from strandline.report import write_report
from strandline.report.figures import BEST, _data
from strandline.report.fit import fit_as_json, fit_figures
from strandline.report.inline import PLOTLY, script_hash
from strandline.report.methods import methods_paragraph
from strandline.report.plots.style import DOUBLE, SINGLE
from strandline.report.run_figures import failed_runs, offsets_of_runs
from strandline.report.warnings import find_warnings

FIGURES = [
    "interfaces",
    "leave_one_out",
    "likelihood",
    "log_likelihood",
    "log_likelihood_sd",
    "marginals",
    "offsets",
    "particles",
    "posterior",
    "residuals",
    "tempering",
]
"""Of a draft of a model of two inputs that has no fields to show."""
SECTIONS = ["asked", "fit", "answer", "data", "runs", "surrogate", "sampler", "paper", "provenance", "explore"]


@pytest.fixture
def text(beam: Finished) -> str:
    return (beam.folder / "report.html").read_text("utf-8")


@pytest.fixture
def page(text: str) -> Page:
    return Page(text)


def test_nothing_is_loaded_from_outside_and_only_the_pages_own_scripts_run(page: Page, text: str) -> None:
    assert {tag for tag, _ in page.tags}.isdisjoint({"link", "iframe", "object", "embed", "video", "audio"})
    for _, attributes in page.tags:
        for name in ("src", "href", "srcset", "data", "poster", "background"):
            assert re.match(r"#|data:image/png;base64,", attributes.get(name) or "#")
    assert not page.open
    (policy,) = [a["content"] for a in page.attributes("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    rules = dict(rule.strip().split(" ", 1) for rule in (policy or "").split(";"))
    assert (rules["default-src"], rules["img-src"], rules["style-src"]) == ("'none'", "data:", "'unsafe-inline'")
    kinds = [one.get("type") in {"application/json", "application/gzip"} for one in page.attributes("script")]
    assert kinds == [True, True, False]
    hashes = rules["script-src"].split()
    assert len(hashes) == 2
    assert all(re.fullmatch(r"'sha256-[A-Za-z0-9+/]{43}='", one) for one in hashes)
    tags = [tag for tag, _ in page.tags]
    assert tags.index("meta") < tags.index("style")
    style = text[text.index("<style>") : text.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style
    (packed,) = re.findall(r'<script type="application/gzip" id="explore-plotly">(.*?)</script>', text)
    library = gzip.decompress(base64.b64decode(packed)).decode("utf-8")
    assert library == PLOTLY.read_text(encoding="utf-8")
    assert f"'{script_hash(library)}'" in hashes
    assert "Permission is hereby granted" in text


def test_every_figure_is_in_the_page_and_in_the_folder_and_every_link_has_its_target(
    page: Page, beam: Finished
) -> None:
    ids = [str(attributes["id"]) for attributes in page.attributes("figure")]
    assert sorted(ids) == FIGURES
    for name, image in zip(ids, page.attributes("img"), strict=True):
        data = base64.b64decode((image["src"] or "").partition(",")[2], validate=True)
        assert data[:8] == b"\x89PNG\r\n\x1a\n"
        assert data == (beam.folder / "figures" / f"{name}.png").read_bytes()
        width = struct.unpack(">II", data[16:24])[0] / 60
        assert width in (pytest.approx(SINGLE, abs=0.04), pytest.approx(DOUBLE, abs=0.04))
        assert image["alt"]
    names = [path.name for path in (beam.folder / "figures").iterdir()]
    assert sorted(names) == [f"{name}.png" for name in FIGURES]
    assert ids.index("residuals") == 0, "whether the model fits comes first"
    targets = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert [attributes["href"] for attributes in page.attributes("a")] == [f"#{name}" for name in SECTIONS]
    assert set(SECTIONS) <= set(targets)
    assert len(set(targets)) == len(targets)


def test_the_numbers_are_those_of_the_summary(page: Page, text: str, beam: Finished) -> None:
    summary = beam.outcome.summary
    for item in summary["inputs"].values():
        for figure in (item["mean"], item["median"], item["q05"], item["q95"], item["map"]):
            assert f"{figure:.4g}" in page.text
    for words in (
        f"evidence {summary['log_evidence']:.5g}".replace("-", "−"),
        "64 of 64 runs of the design succeeded",
        "closest point",
        "1000 particles",
        *(f"{name} {version}" for name, version in summary["versions"].items()),
        "test:beam-1",
        summary["study_sha256"],
        summary["ledger_sha256"],
        (beam.folder / "study.yaml").read_text(),
        "@article{willmann2022bayesian,",
    ):
        assert words in page.text
    paragraph = re.search(r"<blockquote>(.*?)</blockquote>", text, flags=re.S)
    assert paragraph is not None
    assert paragraph[1].replace("&#39;", "'") == methods_paragraph(summary)
    table = text[text.index('<table class="cards">') :]
    labels = re.findall('data-label="([^"]*)"', table[: table.index("</table>")])
    assert labels[:8] == ["unit", "mean", "sd", "median", "5 %", "95 %", "MAP", "truth"]
    fit = summary["misfit"]
    assert (fit["flagged"], fit["p"] > 0.9, fit["conditions"][0]["assumed"]) == (False, True, True)
    assert len(fit["conditions"][0]["regions"]) == 4


def planted(*given: Any, **options: Any) -> Any:
    raise RuntimeError("no ink")


def test_what_fails_is_left_out_where_someone_hears_of_it(
    beam: Finished, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The new report replaces the old one whole; without its section, there is no script."""
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "old.png").touch()
    (tmp_path / "figures" / "next_1.png").touch()
    (tmp_path / ".figures.partial").mkdir()
    (tmp_path / ".figures.partial" / "flow.png").touch()
    monkeypatch.setattr("strandline.report.plots.plot_tempering", planted)
    monkeypatch.setattr("strandline.report.page.explore", planted)
    heard: dict[str, Exception] = {}
    study_text = "# <script src='https://example.org/x.js'></script> & more\n"
    given: dict[str, Any] = {"study_text": study_text, "truth": None, "folder": tmp_path}
    path = write_report(beam.outcome.calibration, beam.outcome.summary, **given, on_failure=heard.__setitem__)
    assert path == tmp_path / "report.html"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["figures", "report.html"]
    assert {name: str(error) for name, error in heard.items()} == {
        "the section Explore": "no ink",
        "figures (sampler)": "no ink",
    }
    text = path.read_text("utf-8")
    page = Page(text)
    for name in heard:
        assert f"{name} could not be written: RuntimeError: no ink" in page.text
    drawn = [name for name in FIGURES if name != "tempering"]
    names = [p.stem for p in (tmp_path / "figures").glob("*.png")]
    assert sorted(names) == sorted([*drawn, "next_1"]), "the answer to a question stays"
    assert sorted(str(attributes["id"]) for attributes in page.attributes("figure")) == drawn
    assert study_text in page.text
    assert not page.attributes("script")
    assert "script-src" not in text
    assert 'id="explore"' not in text


def test_a_figure_that_fails_leaves_the_old_report(
    beam: Finished, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "old.png").touch()
    monkeypatch.setattr("strandline.report.plots.plot_interfaces", planted)
    with pytest.raises(RuntimeError, match="no ink"):
        write_report(beam.outcome.calibration, beam.outcome.summary, study_text="", truth=None, folder=tmp_path)
    assert [p.name for p in tmp_path.rglob("*")] == ["figures", "old.png"]


def test_the_page_leaves_out_what_there_is_not_and_shows_symbols_and_units(beam: Finished) -> None:
    summary = beam.outcome.summary
    seconds = {key: value for key, value in summary["seconds"].items() if key != "report"}
    failed = {**summary["runs"], "failed": 2, "by_kind": {"newton_stalled": 2}}
    inputs = {name: item | {"label": f"{name}_x", "unit": "mm^2/s"} for name, item in summary["inputs"].items()}
    bare = {"quadrature_check": None, "truth": None, "warnings": [], "seconds": seconds, "fixed": {}, "misfit": None}
    text = rendered(summary, **bare, runs=failed, inputs=inputs)
    shown = Page(text).text
    assert [word for word in ("truth", "Quadrature", "Does the model fit?") if word in shown] == []
    assert "#fit" not in text
    assert "No warnings" in shown
    assert "newton_stalled" in shown
    assert text.count("E<sub>x</sub>") >= 2
    assert "mm²\u00a0s⁻¹" in text
    assert "mm^2/s" not in text


def test_the_mass_cut_off_is_the_same_in_table_and_warning_which_tells_no_trifles(beam: Finished) -> None:
    calibration, summary = beam.outcome.calibration, beam.outcome.summary
    cases = {(250.0, 650.0): "1.69%", (200.0, 850.0): "0.03%", (120.0, 900.0): "less than 0.01%"}
    for box, told in cases.items():
        E = Parameter("E", LogNormal(6.0, 0.2), "Pa", box)
        low, high = ((math.log(end) - 6.0) / 0.2 for end in box)
        cut = stats.norm.cdf(low) + stats.norm.sf(high)
        assert told == (f"{cut:.2%}" if cut > 1e-4 else "less than 0.01%")
        space = ParameterSpace((E, calibration.problem.space["tilt"]))
        warned = find_warnings(replace(calibration, problem=replace(calibration.problem, space=space)))
        of_the_cut = [warning for warning in warned if "of its mass was cut off" in warning]
        assert len(of_the_cut) == (cut > 1e-3)
        assert all(f": {told} of its mass was cut off" in warning for warning in of_the_cut)
        inputs = summary["inputs"] | {"E": summary["inputs"]["E"] | {"prior_mass_cut": E.mass_cut}}
        assert f"300 … 560{told}" in Page(rendered(summary, inputs=inputs)).text


def of_fit(beam: Finished, *conditions: Any) -> str:
    return rendered(beam.outcome.summary, draft=False, misfit=fit_as_json(misfit(*conditions), None))


def test_the_fit_has_a_section_before_the_posterior_and_the_first_line_if_it_is_bad(beam: Finished) -> None:
    text = of_fit(beam, condition(FINE))
    section = text[text.index("Does the model fit?</h2>") : text.index("The posterior</h2>")]
    assert section.split("</h2>")[1].lstrip().startswith('<p class="fine"><strong>The model explains the observation')
    assert "predicted by a spell" in section
    assert "1.96" not in section
    assert "<td>2</td>" in section
    assert '<p class="warnings"><strong>' not in text
    bad = of_fit(beam, condition(FINE, BAD))
    first = bad[bad.index("</h1>") + 5 :].lstrip()
    assert first.startswith('<p class="warnings"><strong>The model does not explain the observation')


def test_every_part_of_the_arc_is_in_a_table_that_is_folded_if_it_is_long(beam: Finished) -> None:
    few = of_fit(beam, condition(FINE, BAD))
    assert "<tr><td>0.9 – 1.1</td><td>6</td><td>6.5</td><td>5.2</td><td>0.0004</td></tr>" in few
    assert "<tr><td>0 – 0.9</td><td>0.1</td><td>1</td><td>0.4</td><td>1</td></tr>" in few
    assert "<details>" not in few
    many = of_fit(beam, condition(*[FINE] * 6, BAD), condition(FINE, name="V100"))
    assert "<details>" in many
    assert "<td>V50</td><td>0.9 – 1.1</td>" in many
    assert "parts of the interface" not in of_fit(beam, condition(line=False))
    patch = replace(BAD, begin=0.0, end=0.0, centre=(0.81, 0.2, 0.05))
    surface = of_fit(beam, condition(FINE, line=True), condition(patch, line=False))
    assert "<td>(0.81, 0.2, 0.05)</td><td>6</td>" in surface


def test_a_figure_shows_the_residuals_of_each_condition(beam: Finished) -> None:
    calibration = beam.outcome.calibration
    found = misfit(condition(FINE, BAD), condition(FINE, name="V100"), condition(name="surface", line=False))
    (shown,) = fit_figures(replace(calibration, misfit=found))
    assert (shown.name, shown.section) == ("residuals", "fit")
    assert [ax.get_title() for ax in shown.figure.axes] == ["V50", "V100"]
    lines = {str(line.get_label()): line for line in shown.figure.axes[0].lines}
    np.testing.assert_allclose(lines["observed"].get_ydata(), 1e3 * found.conditions[0].residual)
    labels = [text.get_text() for text in shown.figure.legends[0].get_texts()]
    assert "more than the noise allows" in labels
    for nothing in (misfit(condition(line=False)), None):
        assert not list(fit_figures(replace(calibration, misfit=nothing)))


def of_noise(beam: Finished, stated: bool, sd: tuple[float, ...], length: tuple[float, ...], **others: Any) -> str:
    """Return the page of a study with this inferred noise: quantiles in µm."""
    levels = ("q05", "median", "q95")
    found = {name: dict(zip(levels, one, strict=True)) for name, one in (("sd_um", sd), ("length_um", length))}
    likelihood = {**beam.outcome.summary["likelihood"], "inferred_noise": {**found, "stated": stated, **others}}
    return rendered(beam.outcome.summary, likelihood=likelihood).replace("&nbsp;", " ")


def test_inferred_noise_has_quantiles_beside_what_was_stated(beam: Finished, text: str) -> None:
    """The evidence leaves out another constant then."""
    constant = "additive constant differs from that of a study with stated noise"
    found = of_noise(beam, False, (2.0, 3.0, 4.0), (15.0, 15.0, 15.0))
    assert (
        "<p>The noise is inferred from the residuals (median, 5 % and 95 % quantile): standard deviation of a point "
        "3 (2 to 4) µm, correlation length 15 µm." in found
    )
    assert constant in found
    assert constant not in text
    prior: dict[str, Any] = {"sd_um": [1.0, 10.0], "length_um": None}
    alone = of_noise(beam, False, (2.0, 3.0, 4.0), (10.0, 15.0, 21.0), prior=prior)
    row = '<td class="text">log-uniform from 1 to 10</td><td>3</td><td>2</td><td>4</td>'
    assert f"<tr><td>sd of a point</td>{row}</tr>" in alone
    assert '<td class="text">unknown: log-uniform over a wide range</td><td>15</td><td>10</td><td>21</td>' in alone
    assert "if there is one" not in alone


def test_a_model_error_has_quantiles_of_its_own_and_noise_that_is_stated_has_none(beam: Finished) -> None:
    ends = {"q05": 60.0, "median": 170.0, "q95": 600.0}
    error = {"probability": 0.97, "amplitude_um": 2.0, "spread": 0.0, "amplitude_quantiles_um": ends}
    stated: Any = (True, (3.0, 3.0, 3.0), (1e-9, 1e-9, 1e-9))
    text = of_noise(beam, *stated, model_error=error, without_model_error={"E": {"mean": 401.0, "sd": 2.0}})
    assert "<p>Noise: standard deviation of a point 3 µm, correlation length 0 µm." in text
    assert "with probability 0.97; if it has one, this is a smooth offset of 170 µm (amplitude, median)." in text
    assert "It allows for model error. Without it: " in text
    both = {"sd_um": 3.0, "length_um": 0.0}
    text = of_noise(beam, *stated, prior=both, model_error={**error, "length_um": ends})
    assert '<td>sd of a point</td><td class="text">3, known</td><td>3</td>' in text
    assert '<td>correlation length</td><td class="text">0, known</td><td>0</td>' in text
    assert text.count("<td>170</td><td>60</td><td>600</td>") == 2


def test_the_report_says_how_each_picture_was_read(beam: Finished) -> None:
    notes = ["pixel size 8 × 8 µm from the study", "its axes point y up (default)"]
    one = {"condition": "", "file": "drop.png", "sha256": "0123456789abcdef", "notes": notes}
    said = "pixel size 8 × 8 µm from the study; its axes point y up (default); sha256 0123456789ab…"
    cell = f'<tr><td class="text">drop.png</td><td class="text">{said}</td></tr>'
    assert cell in rendered(beam.outcome.summary, pictures=[one])
    assert "<td>slow</td>" in rendered(beam.outcome.summary, pictures=[one, {**one, "condition": "slow"}])
    assert "read as" not in rendered(beam.outcome.summary, pictures=[])


def test_runs_are_drawn_where_the_observation_has_other_nodes_and_no_rest_is_known(beam: Finished) -> None:
    calibration = beam.outcome.calibration
    problem = calibration.problem
    assert not hasattr(problem.model, "undeformed")
    (seen,) = problem.observations
    coarser = replace(seen, interface=Interface.polyline(seen.interface.points[::4]))
    (shown,) = _data(replace(calibration, problem=replace(problem, observations=(coarser,))), None)
    assert "undeformed" not in shown.caption
    (ax,) = shown.figure.axes
    lines = {str(line.get_label()): np.asarray(line.get_xydata()) for line in ax.lines}
    assert len(lines["observed"]) == len(coarser.interface.points)
    assert len(lines) >= 4
    best = next(line for label, line in lines.items() if label.startswith(BEST))
    ok = [record for record in calibration.records if record.ok]
    number = int(np.argmax(calibration.log_likelihoods["tracked_points"]))
    np.testing.assert_array_equal(best, ok[number].interfaces[""].points)


def test_figures_of_the_best_runs_and_of_the_failed_ones(beam: Finished) -> None:
    calibration = beam.outcome.calibration
    (shown,) = offsets_of_runs(calibration)
    assert (shown.name, shown.section) == ("offsets", "data")
    labels = [str(line.get_label()) for line in shown.figure.axes[0].lines]
    assert labels[-2:] == ["best run", "observed"]
    assert len(labels) == 6
    space = ParameterSpace((*calibration.problem.space, Parameter("load", Uniform(0.0, 2e-5), "N/m")))
    records = [replace(r, state="failed", failure_kind="stalled", interfaces={}) for r in calibration.records[:3]]
    three = replace(calibration, problem=replace(calibration.problem, space=space))
    broken = replace(three, records=(*records, *calibration.records[3:]))
    (shown,) = failed_runs(broken)
    assert (shown.name, shown.section) == ("failed_runs", "runs")
    legend = shown.figure.axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["ok: 61", "stalled: 3"]
    two_inputs = replace(calibration, records=broken.records)
    assert not list(failed_runs(two_inputs)), "the maps show them"
    assert not list(failed_runs(three))
