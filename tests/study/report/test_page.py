"""The report of a finished study: self-contained, whole, with every figure and number; the data of its panels."""

import base64
import gzip
import json
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
from tests.study.report.pages import Page, data_in, rendered
from tests.unit.report.fits import BAD, FINE, condition, misfit
from tests.unit.report.plots.drawn import entries, lines

from strandline.calibration import Calibration
from strandline.discrepancy.normal_offset import signed_distances
from strandline.interface import Interface
from strandline.parameters import LogNormal, Parameter, ParameterSpace, Uniform
from strandline.report import explore as section
from strandline.report import write_report
from strandline.report.explore import explore
from strandline.report.figures import BEST, _data, failed_runs, fit_figures
from strandline.report.fit import fit_as_json
from strandline.report.html import PLOTLY, script_hash
from strandline.report.page import methods_paragraph
from strandline.report.plots.style import DOUBLE, SINGLE
from strandline.report.warnings import find_warnings
from strandline.runs.ledger.ledger_schema import LOG_TITLE

FIGURES = [
    "interfaces", "leave_one_out", "likelihood", "log_likelihood", "log_likelihood_sd", "marginals", "offsets",
    "particles", "posterior", "residuals", "tempering",
]  # fmt: skip
"""Of a draft of a model of two inputs that has no fields to show."""


@pytest.fixture
def calibration(beam: Finished) -> Calibration:
    return beam.outcome.calibration


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
    hashes = rules["script-src"].split()
    assert [bool(re.fullmatch(r"'sha256-[A-Za-z0-9+/]{43}='", one)) for one in hashes] == [True, True]
    assert text.index("<meta") < text.index("<style")
    assert not re.search(r"url\(|@import", text[text.index("<style>") : text.index("</style>")])
    (packed,) = re.findall(r'<script type="application/gzip" id="explore-plotly">(.*?)</script>', text)
    library = gzip.decompress(base64.b64decode(packed)).decode("utf-8")
    assert library == PLOTLY.read_text(encoding="utf-8")
    assert f"'{script_hash(library)}'" in hashes


def test_every_figure_is_in_page_and_folder_and_every_link_has_its_target(page: Page, beam: Finished) -> None:
    ids = [str(attributes["id"]) for attributes in page.attributes("figure")]
    assert sorted(ids) == FIGURES
    for name, image in zip(ids, page.attributes("img"), strict=True):
        data = base64.b64decode((image["src"] or "").partition(",")[2], validate=True)
        assert data == (beam.folder / "figures" / f"{name}.png").read_bytes()
        width = struct.unpack(">II", data[16:24])[0] / 60
        assert width in (pytest.approx(SINGLE, abs=0.04), pytest.approx(DOUBLE, abs=0.04))
        assert image["alt"]
    assert sorted(path.name for path in (beam.folder / "figures").iterdir()) == [f"{name}.png" for name in FIGURES]
    assert ids.index("residuals") == 0, "whether the model fits comes first"
    targets = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert {attributes["href"].removeprefix("#") for attributes in page.attributes("a")} <= set(targets)
    assert len(set(targets)) == len(targets)


def test_the_numbers_are_those_of_the_summary(page: Page, text: str, beam: Finished) -> None:
    summary = beam.outcome.summary
    for item in summary["inputs"].values():
        for figure in (item["mean"], item["median"], item["q05"], item["q95"], item["map"]):
            assert f"{figure:.4g}" in page.text
    for words in (
        f"evidence {summary['log_evidence']:.5g}".replace("-", "−"),
        "64 of 64 runs of the design succeeded",
        *(f"{name} {version}" for name, version in summary["versions"].items()),
        summary["study_sha256"],
        summary["ledger_sha256"],
        (beam.folder / "study.yaml").read_text(),
        "@article{willmann2022bayesian,",
    ):
        assert words in page.text
    (paragraph,) = re.findall(r"<blockquote>(.*?)</blockquote>", text, flags=re.S)
    assert paragraph.replace("&#39;", "'") == methods_paragraph(summary)


def test_the_page_leaves_out_what_there_is_not_and_shows_symbols_and_units(beam: Finished) -> None:
    summary, other = beam.outcome.summary, {"label": "E_x", "unit": "mm^2/s"}
    bare = {"quadrature_check": None, "truth": None, "warnings": [], "fixed": {}, "misfit": None}
    text = rendered(summary, **bare, inputs={name: item | other for name, item in summary["inputs"].items()})
    shown = Page(text).text
    assert [word for word in ("truth", "Quadrature", "Does the model fit?", "mm^2/s") if word in shown] == []
    assert "mm²\u00a0s⁻¹" in shown
    assert text.count("E<sub>x</sub>") >= 2


def test_prior_correlations_are_stated(beam: Finished) -> None:
    correlated = beam.outcome.summary | {"correlation": [{"between": ["E", "tilt"], "value": 0.6}]}
    assert ", with a correlation of 0.6 between E and tilt." in methods_paragraph(correlated)
    assert "(of normal quantiles): 0.6 between E and tilt." in Page(rendered(correlated)).text


def planted(*given: Any, **options: Any) -> Any:
    raise RuntimeError("no ink")


def test_what_fails_is_left_out_where_someone_hears_of_it(beam: Finished, tmp_path: Path, monkeypatch: Any) -> None:
    """A figure that fails leaves the old report, unless someone hears of it: then a new one replaces it whole."""
    study_text = "# <script src='https://example.org/x.js'></script> & more\n"
    given: Any = {"study_text": study_text, "truth": None, "folder": tmp_path}
    (tmp_path / "figures").mkdir()
    for old in ("old", "next_1"):
        (tmp_path / "figures" / f"{old}.png").touch()
    (tmp_path / "next.html").touch()
    with monkeypatch.context() as patch:
        patch.setattr("strandline.report.plots.plot_interfaces", planted)
        with pytest.raises(RuntimeError, match="no ink"):
            write_report(beam.outcome.calibration, beam.outcome.summary, **given)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["figures", "next.html", "next_1.png", "old.png"]
    (tmp_path / ".figures.partial").mkdir()
    monkeypatch.setattr("strandline.report.plots.plot_tempering", planted)
    monkeypatch.setattr("strandline.report.page.explore", planted)
    heard: dict[str, Exception] = {}
    path = write_report(beam.outcome.calibration, beam.outcome.summary, **given, on_failure=heard.__setitem__)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["figures", "next.html", "report.html"]
    assert set(heard) == {"the section Explore", "figures (sampler)"}
    page = Page(path.read_text("utf-8"))
    for name in heard:
        assert f"{name} could not be written: RuntimeError: no ink" in page.text
    drawn = [name for name in FIGURES if name != "tempering"]
    names = sorted(p.stem for p in (tmp_path / "figures").glob("*.png"))
    assert names == sorted([*drawn, "next_1"]), "the answer to a question stays"
    assert study_text in page.text
    assert not page.attributes("script")


@pytest.mark.parametrize(("low", "high", "told"), [(250.0, 650.0, "1.69%"), (200.0, 850.0, "0.03%")])
def test_the_mass_cut_off_is_the_same_in_table_and_warning_which_tells_no_trifles(
    low: float, high: float, told: str, beam: Finished, calibration: Calibration
) -> None:
    E, log = Parameter("E", LogNormal(6.0, 0.2), "Pa", (low, high)), stats.norm(6.0, 0.2)
    assert told == f"{log.cdf(math.log(low)) + log.sf(math.log(high)):.2%}"
    space = ParameterSpace((E, calibration.problem.space["tilt"]))
    warned = find_warnings(replace(calibration, problem=replace(calibration.problem, space=space)))
    assert [f"{told} of its mass" in one for one in warned if "was cut off" in one] == [True] * (told == "1.69%")
    inputs = beam.outcome.summary["inputs"]
    inputs = inputs | {"E": inputs["E"] | {"prior_mass_cut": E.mass_cut}}
    assert f"300 … 560{told}" in Page(rendered(beam.outcome.summary, inputs=inputs)).text


def of_fit(beam: Finished, *conditions: Any) -> str:
    return rendered(beam.outcome.summary, draft=False, misfit=fit_as_json(misfit(*conditions), None))


def test_the_fit_has_a_section_before_the_posterior_and_the_first_line_if_it_is_bad(beam: Finished) -> None:
    """Every part of the arc is in a table."""
    text = of_fit(beam, condition(FINE))
    section = text[text.index("Does the model fit?</h2>") : text.index("The posterior</h2>")]
    assert section.split("</h2>")[1].lstrip().startswith('<p class="fine"><strong>The model explains the observation')
    assert '<p class="warnings"><strong>' not in text
    few = of_fit(beam, condition(FINE, BAD))
    first = few[few.index("</h1>") + 5 :].lstrip()
    assert first.startswith('<p class="warnings"><strong>The model does not explain the observation')
    assert "<tr><td>0.9 – 1.1</td><td>6</td><td>6.5</td><td>5.2</td><td>0.0004</td></tr>" in few


def test_a_figure_shows_the_residuals_of_each_condition(calibration: Calibration) -> None:
    found = misfit(condition(FINE, BAD), condition(FINE, name="V100"), condition(name="surface", line=False))
    (shown,) = fit_figures(replace(calibration, misfit=found))
    assert [ax.get_title() for ax in shown.figure.axes] == ["V50", "V100"]
    (observed,) = lines(shown.figure.axes[0], "observed")
    np.testing.assert_allclose(observed[:, 1], 1e3 * found.conditions[0].residual)


def test_inferred_noise_and_a_model_error_have_quantiles_beside_what_was_stated(beam: Finished, text: str) -> None:
    """The evidence leaves out another constant then."""
    size = {"q05": 60.0, "median": 170.0, "q95": 600.0}
    error = {"probability": 0.97, "spread": 0.0, "amplitude_quantiles_um": size, "length_um": size}
    prior = {"sd_um": [1.0, 10.0], "length_um": 0.0}
    inferred = {"sd_um": size, "length_um": size, "stated": False, "prior": prior, "model_error": error}
    likelihood = {**beam.outcome.summary["likelihood"], "inferred_noise": inferred}
    page = rendered(beam.outcome.summary, likelihood=likelihood).replace("&nbsp;", " ")
    for words in (
        '<td class="text">log-uniform from 1 to 10</td><td>170</td><td>60</td><td>600</td></tr>',
        '<td>correlation length</td><td class="text">0, known</td><td>170</td>',
        "with probability 0.97; if it has one, this is a smooth offset of 170 µm (amplitude, median).",
        'if there is one</td><td class="text">unknown</td><td>170</td><td>60</td><td>600</td>',
        "additive constant differs from that of a study with stated noise",
    ):
        assert words in page
    assert "additive constant differs" not in text


def test_the_best_runs_are_drawn_where_the_observation_has_other_nodes(calibration: Calibration) -> None:
    problem = calibration.problem
    (seen,) = problem.observations
    coarser = replace(seen, interface=Interface.polyline(seen.interface.points[::4]))
    (shown,) = _data(replace(calibration, problem=replace(problem, observations=(coarser,))), None)
    drawn = {str(line.get_label()): np.asarray(line.get_xydata()) for line in shown.figure.axes[0].lines}
    assert len(drawn["observed"]) == len(coarser.interface.points)
    best = next(line for label, line in drawn.items() if label.startswith(BEST))
    number = int(np.argmax(calibration.log_likelihoods["tracked_points"]))  # all runs succeeded
    np.testing.assert_array_equal(best, calibration.records[number].interfaces[""].points)


def test_failed_runs_of_three_inputs_have_a_figure(calibration: Calibration) -> None:
    space = ParameterSpace((*calibration.problem.space, Parameter("load", Uniform(0.0, 2e-5), "N/m")))
    records = [replace(r, state="failed", failure_kind="stalled", interfaces={}) for r in calibration.records[:3]]
    broken = replace(calibration, records=(*records, *calibration.records[3:]))
    (shown,) = failed_runs(replace(broken, problem=replace(calibration.problem, space=space, fixed={})))
    (ax,) = shown.figure.axes
    assert entries(ax) == ["ok: 61", "stalled: 3"]
    at = np.array([[record.inputs[name] for name in space.names] for record in records])
    np.testing.assert_allclose(np.array(ax.collections[1].get_segments())[:, :, 1], space.to_unit(at))


def many(calibration: Calibration) -> Calibration:
    """Return the calibration as if 1500 runs had been made, of which every third failed.

    Its own runs come again, with long messages and logs, many figures and interfaces of a thousand points.
    """
    x, long, figures = np.linspace(0.0, 1.0, 1000), "x" * 10_000, {f"figure {i}": 1 / (i + 3) for i in range(20)}
    lines = [Interface.polyline(np.stack([x, 0.1 * x**2 + 1e-4 * k / 7], axis=1)) for k in range(1500)]
    runs = [
        replace(calibration.records[k % 64], key=f"k{k}", diagnostics=figures, interfaces={"": line})
        for k, line in enumerate(lines)
    ]
    failed: Any = {"state": "failed", "failure_kind": "</script><b>", "interfaces": {}}
    runs[::3] = [replace(one, **failed, message=f"{long}\n{LOG_TITLE}\n{long}", log=long) for one in runs[::3]]
    log = "\n".join(map(str, range(50)))
    runs[0] = replace(runs[0], message=f"no </script> here\n{LOG_TITLE}\nlast", log=log)
    rows = [k % 64 for k in range(1500) if k % 3]
    (seen,) = calibration.problem.observations
    return replace(
        calibration,
        problem=replace(calibration.problem, observations=(replace(seen, interface=lines[0]),)),
        records=tuple(runs),
        log_likelihoods={name: one[rows] for name, one in calibration.log_likelihoods.items()},
        training=calibration.training[rows],
        made=(),
    )


def test_the_page_holds_the_runs_as_they_are_and_the_posterior(beam: Finished, text: str) -> None:
    data, calibration = data_in(text), beam.outcome.calibration
    runs, records = data["runs"], calibration.all_runs
    assert runs["row"] == list(range(len(records)))
    assert runs["state"] == [record.state for record in records]
    for name in calibration.problem.space.names:
        assert runs["inputs"][name] == pytest.approx([record.inputs[name] for record in records], rel=1e-5)
    (seen,) = calibration.problem.observations
    assert len(data["interfaces"]) == len(records)
    own, found = records[17].interfaces[""], data["interfaces"]["17"][""]
    assert np.allclose(np.transpose(found["line"]), own.points, atol=1e-6)
    off = 1e3 * signed_distances(seen.interface.points, own)
    assert found["offsets"] == pytest.approx(off.tolist(), rel=1e-3)
    assert np.allclose(np.transpose(data["facts"]["conditions"][0]["observed"]), seen.interface.points, atol=1e-6)
    posterior = data["posterior"]
    for name, item in beam.outcome.summary["inputs"].items():
        draws, moments = posterior["draws"][name], (posterior["mean"][name], posterior["sd"][name])
        assert moments == pytest.approx((item["mean"], item["sd"]))
        assert float(np.mean(draws)) == pytest.approx(item["mean"], abs=0.1 * item["sd"])
        assert float(np.std(draws)) == pytest.approx(item["sd"], rel=0.1)
    line, band = (np.array(posterior["bands"][""][name]) for name in ("line", "band"))
    upper, lower = band[:, : line.shape[1]], band[:, line.shape[1] :][:, ::-1]
    assert np.allclose((upper + lower) / 2, line, atol=2e-6)
    assert (np.linalg.norm(upper - lower, axis=0)[1:] > 0).all()


def test_of_many_long_runs_the_best_and_some_of_all_are_kept_and_the_data_stay_small(calibration: Calibration) -> None:
    other = many(calibration)
    found = explore(other, None)
    data = json.loads(found["data"])
    rows = data["runs"]["row"]
    assert (found["runs"], found["of"], found["outlines"]) == (1000, 1500, section.MOST_NUMBERS // 1200)
    assert rows == sorted(set(rows))
    values, used = next(iter(other.log_likelihoods.values())), [k for k in range(1500) if k % 3]
    best = [used[i] for i in np.argsort(-values, kind="stable")]
    assert set(best[:500]) <= set(rows)
    assert {str(row) for row in best[:50]} <= set(data["interfaces"]) <= {str(row) for row in rows}
    assert max(np.diff(rows)) < 40
    assert data["runs"]["state"].count("failed") > 20
    assert "<" not in found["data"]
    assert (rows[0], data["runs"]["state"][0], data["runs"]["kind"][0]) == (0, "failed", "</script><b>")
    assert data["details"]["0"]["message"] == "no </script> here"
    assert data["details"]["0"]["log"].splitlines() == [str(k) for k in range(42, 50)]
    assert all(len(one[""]["line"][0]) <= 100 for one in data["interfaces"].values())
    assert found["size"] < 2_200_000
