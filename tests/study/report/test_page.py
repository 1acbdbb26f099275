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
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import LogNormal, Uniform
from strandline.report import explore as section
from strandline.report import write_report
from strandline.report.explore import explore
from strandline.report.figures import BEST, _data
from strandline.report.fit import fit_as_json, fit_figures
from strandline.report.inline import PLOTLY, script_hash
from strandline.report.methods import methods_paragraph
from strandline.report.plots.style import DOUBLE, SINGLE
from strandline.report.run_figures import failed_runs, offsets_of_runs
from strandline.report.warnings import find_warnings
from strandline.runs import RunRecord
from strandline.runs.tables import LOG_TITLE

FIGURES = [
    "interfaces", "leave_one_out", "likelihood", "log_likelihood", "log_likelihood_sd", "marginals", "offsets",
    "particles", "posterior", "residuals", "tempering",
]  # fmt: skip
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
    assert [bool(re.fullmatch(r"'sha256-[A-Za-z0-9+/]{43}='", one)) for one in hashes] == [True, True]
    assert text.index("<meta") < text.index("<style")
    assert not re.search(r"url\(|@import", text[text.index("<style>") : text.index("</style>")])
    (packed,) = re.findall(r'<script type="application/gzip" id="explore-plotly">(.*?)</script>', text)
    library = gzip.decompress(base64.b64decode(packed)).decode("utf-8")
    assert library == PLOTLY.read_text(encoding="utf-8")
    assert f"'{script_hash(library)}'" in hashes
    assert "Permission is hereby granted" in text


def test_every_figure_is_in_page_and_folder_and_every_link_has_its_target(page: Page, beam: Finished) -> None:
    ids = [str(attributes["id"]) for attributes in page.attributes("figure")]
    assert sorted(ids) == FIGURES
    for name, image in zip(ids, page.attributes("img"), strict=True):
        data = base64.b64decode((image["src"] or "").partition(",")[2], validate=True)
        assert data[:8] == b"\x89PNG\r\n\x1a\n"
        assert data == (beam.folder / "figures" / f"{name}.png").read_bytes()
        width = struct.unpack(">II", data[16:24])[0] / 60
        assert width in (pytest.approx(SINGLE, abs=0.04), pytest.approx(DOUBLE, abs=0.04))
        assert image["alt"]
    assert sorted(path.name for path in (beam.folder / "figures").iterdir()) == [f"{name}.png" for name in FIGURES]
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
    (paragraph,) = re.findall(r"<blockquote>(.*?)</blockquote>", text, flags=re.S)
    assert paragraph.replace("&#39;", "'") == methods_paragraph(summary)
    table = text[text.index('<table class="cards">') :]
    labels = re.findall('data-label="([^"]*)"', table[: table.index("</table>")])
    assert labels[:8] == ["unit", "mean", "sd", "median", "5 %", "95 %", "MAP", "truth"]
    fit = summary["misfit"]
    assert (fit["flagged"], fit["p"] > 0.9, fit["conditions"][0]["assumed"]) == (False, True, True)
    assert len(fit["conditions"][0]["regions"]) == 4


def planted(*given: Any, **options: Any) -> Any:
    raise RuntimeError("no ink")


def test_what_fails_is_left_out_where_someone_hears_of_it(beam: Finished, tmp_path: Path, monkeypatch: Any) -> None:
    """A figure that fails leaves the old report, unless someone hears of it: then a new one replaces it whole."""
    study_text = "# <script src='https://example.org/x.js'></script> & more\n"
    given: Any = {"study_text": study_text, "truth": None, "folder": tmp_path}
    for old in ("figures/old.png", "figures/next_1.png"):
        (tmp_path / old).parent.mkdir(exist_ok=True)
        (tmp_path / old).touch()
    with monkeypatch.context() as patch:
        patch.setattr("strandline.report.plots.plot_interfaces", planted)
        with pytest.raises(RuntimeError, match="no ink"):
            write_report(beam.outcome.calibration, beam.outcome.summary, **given)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["figures", "next_1.png", "old.png"]
    (tmp_path / ".figures.partial").mkdir()
    (tmp_path / ".figures.partial" / "flow.png").touch()
    monkeypatch.setattr("strandline.report.plots.plot_tempering", planted)
    monkeypatch.setattr("strandline.report.page.explore", planted)
    heard: dict[str, Exception] = {}
    path = write_report(beam.outcome.calibration, beam.outcome.summary, **given, on_failure=heard.__setitem__)
    assert path == tmp_path / "report.html"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["figures", "report.html"]
    assert set(heard) == {"the section Explore", "figures (sampler)"}
    text = path.read_text("utf-8")
    page = Page(text)
    for name in heard:
        assert f"{name} could not be written: RuntimeError: no ink" in page.text
    drawn = [name for name in FIGURES if name != "tempering"]
    names = {p.stem for p in (tmp_path / "figures").glob("*.png")}
    assert names == {*drawn, "next_1"}, "the answer to a question stays"
    assert sorted(str(attributes["id"]) for attributes in page.attributes("figure")) == drawn
    assert study_text in page.text
    assert not page.attributes("script")
    assert "script-src" not in text
    assert 'id="explore"' not in text


def test_the_page_leaves_out_what_there_is_not_and_shows_symbols_and_units(beam: Finished) -> None:
    summary = beam.outcome.summary
    seconds = {key: value for key, value in summary["seconds"].items() if key != "report"}
    failed = {**summary["runs"], "failed": 2, "by_kind": {"newton_stalled": 2}}
    inputs = {name: item | {"label": f"{name}_x", "unit": "mm^2/s"} for name, item in summary["inputs"].items()}
    bare = {"quadrature_check": None, "truth": None, "warnings": [], "seconds": seconds, "fixed": {}, "misfit": None}
    text = rendered(summary, **bare, runs=failed, inputs=inputs)
    shown = Page(text).text
    assert [word for word in ("truth", "Quadrature", "Does the model fit?") if word in shown] == []
    assert [word for word in ("No warnings", "newton_stalled", "mm²\u00a0s⁻¹") if word not in shown] == []
    assert [word for word in ("#fit", "mm^2/s") if word in text] == []
    assert text.count("E<sub>x</sub>") >= 2


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
        assert all(f"the design box [{box[0]:g}, {box[1]:g}] Pa: {told} of its mass" in one for one in of_the_cut)
        inputs = summary["inputs"] | {"E": summary["inputs"]["E"] | {"prior_mass_cut": E.mass_cut}}
        assert f"300 … 560{told}" in Page(rendered(summary, inputs=inputs)).text


def of_fit(beam: Finished, *conditions: Any) -> str:
    return rendered(beam.outcome.summary, draft=False, misfit=fit_as_json(misfit(*conditions), None))


def test_the_fit_has_a_section_before_the_posterior_and_the_first_line_if_it_is_bad(beam: Finished) -> None:
    """Every part of the arc is in a table, which is folded if it is long."""
    text = of_fit(beam, condition(FINE))
    section = text[text.index("Does the model fit?</h2>") : text.index("The posterior</h2>")]
    assert section.split("</h2>")[1].lstrip().startswith('<p class="fine"><strong>The model explains the observation')
    assert "predicted by a spell" in section
    assert "1.96" not in section
    assert "<td>2</td>" in section
    assert '<p class="warnings"><strong>' not in text
    few = of_fit(beam, condition(FINE, BAD))
    first = few[few.index("</h1>") + 5 :].lstrip()
    assert first.startswith('<p class="warnings"><strong>The model does not explain the observation')
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
    (observed,) = lines(shown.figure.axes[0], "observed")
    np.testing.assert_allclose(observed[:, 1], 1e3 * found.conditions[0].residual)
    assert "more than the noise allows" in entries(shown.figure)
    for nothing in (misfit(condition(line=False)), None):
        assert not list(fit_figures(replace(calibration, misfit=nothing)))


def quantiles(low: float, median: float, high: float) -> dict[str, float]:
    return {"q05": low, "median": median, "q95": high}


WIDE = {"sd_um": quantiles(2.0, 3.0, 4.0), "length_um": quantiles(10.0, 15.0, 21.0), "stated": False}
STATED = {"sd_um": quantiles(3.0, 3.0, 3.0), "length_um": quantiles(1e-9, 1e-9, 1e-9), "stated": True}
ENDS = quantiles(60.0, 170.0, 600.0)
ERROR = {"probability": 0.97, "amplitude_um": 2.0, "spread": 0.0, "amplitude_quantiles_um": ENDS}
NOISES = [
    (
        {**WIDE, "length_um": quantiles(15.0, 15.0, 15.0)},
        "<p>The noise is inferred from the residuals (median, 5 % and 95 % quantile): standard deviation of a point "
        "3 (2 to 4) µm, correlation length 15 µm.",
        "additive constant differs from that of a study with stated noise",
    ),
    (
        {**WIDE, "prior": {"sd_um": [1.0, 10.0], "length_um": None}},
        '<tr><td>sd of a point</td><td class="text">log-uniform from 1 to 10</td><td>3</td><td>2</td><td>4</td></tr>',
        '<td class="text">unknown: log-uniform over a wide range</td><td>15</td><td>10</td><td>21</td>',
    ),
    (
        {**STATED, "model_error": ERROR, "without_model_error": {"E": {"mean": 401.0, "sd": 2.0}}},
        "<p>Noise: standard deviation of a point 3 µm, correlation length 0 µm.",
        "with probability 0.97; if it has one, this is a smooth offset of 170 µm (amplitude, median).",
        "It allows for model error. Without it: ",
    ),
    (
        {**STATED, "prior": {"sd_um": 3.0, "length_um": 0.0}, "model_error": {**ERROR, "length_um": ENDS}},
        '<td>sd of a point</td><td class="text">3, known</td><td>3</td>',
        '<td>correlation length</td><td class="text">0, known</td><td>0</td>',
        "<td>170</td><td>60</td><td>600</td>",
    ),
]


def test_inferred_noise_and_a_model_error_have_quantiles_beside_what_was_stated(beam: Finished, text: str) -> None:
    """The evidence leaves out another constant then."""
    for inferred, *words in NOISES:
        likelihood = {**beam.outcome.summary["likelihood"], "inferred_noise": inferred}
        page = rendered(beam.outcome.summary, likelihood=likelihood).replace("&nbsp;", " ")
        assert [one for one in words if one not in page] == []
        assert ("if there is one" in page) <= ("model_error" in inferred)
    assert page.count("<td>170</td><td>60</td><td>600</td>") == 2
    assert "additive constant differs" not in text


def test_the_report_says_how_each_picture_was_read(beam: Finished) -> None:
    notes = ["pixel size 8 × 8 µm from the study", "its axes point y up (default)"]
    one = {"condition": "", "file": "drop.png", "sha256": "0123456789abcdef", "notes": notes}
    cell = f'<tr><td class="text">drop.png</td><td class="text">{"; ".join(notes)}; sha256 0123456789ab…</td></tr>'
    assert cell in rendered(beam.outcome.summary, pictures=[one])
    assert "<td>slow</td>" in rendered(beam.outcome.summary, pictures=[one, {**one, "condition": "slow"}])
    assert "read as" not in rendered(beam.outcome.summary, pictures=[])


def test_runs_are_drawn_where_the_observation_has_other_nodes_and_no_rest_is_known(beam: Finished) -> None:
    calibration = beam.outcome.calibration
    problem = calibration.problem
    (seen,) = problem.observations
    coarser = replace(seen, interface=Interface.polyline(seen.interface.points[::4]))
    (shown,) = _data(replace(calibration, problem=replace(problem, observations=(coarser,))), None)
    assert "undeformed" not in shown.caption
    drawn = {str(line.get_label()): np.asarray(line.get_xydata()) for line in shown.figure.axes[0].lines}
    assert len(drawn["observed"]) == len(coarser.interface.points)
    assert len(drawn) >= 4
    best = next(line for label, line in drawn.items() if label.startswith(BEST))
    number = int(np.argmax(calibration.log_likelihoods["tracked_points"]))  # all runs succeeded
    np.testing.assert_array_equal(best, calibration.records[number].interfaces[""].points)


def test_figures_of_the_best_runs_and_of_the_failed_ones(beam: Finished) -> None:
    calibration = beam.outcome.calibration
    (shown,) = offsets_of_runs(calibration)
    assert (shown.name, shown.section) == ("offsets", "data")
    _, _, _, _, *last = [line.get_label() for line in shown.figure.axes[0].lines]
    assert last == ["best run", "observed"]
    space = ParameterSpace((*calibration.problem.space, Parameter("load", Uniform(0.0, 2e-5), "N/m")))
    records = [replace(r, state="failed", failure_kind="stalled", interfaces={}) for r in calibration.records[:3]]
    three = replace(calibration, problem=replace(calibration.problem, space=space))
    broken = replace(three, records=(*records, *calibration.records[3:]))
    (shown,) = failed_runs(broken)
    assert (shown.name, shown.section) == ("failed_runs", "runs")
    assert entries(shown.figure.axes[0]) == ["ok: 61", "stalled: 3"]
    assert not list(failed_runs(replace(calibration, records=broken.records))), "the maps show two inputs"
    assert not list(failed_runs(three))


@pytest.fixture
def calibration(beam: Finished) -> Calibration:
    return beam.outcome.calibration


def as_failed(record: RunRecord, message: str, log: str) -> RunRecord:
    return replace(record, state="failed", interfaces={}, failure_kind="</script><b>", message=message, log=log)


def with_runs(calibration: Calibration, records: list[RunRecord], rows: list[int]) -> Calibration:
    """Return the calibration with other runs; `rows` says which of its own stand for those that succeeded."""
    values = {name: one[rows] for name, one in calibration.log_likelihoods.items()}
    training = calibration.training[rows]
    return replace(calibration, records=tuple(records), log_likelihoods=values, training=training, made=())


def many(calibration: Calibration, number: int, *, points: int, every_failed: int) -> Calibration:
    """Return the calibration as if so many runs had been made: its own runs again, with other interfaces."""
    good = [record for record in calibration.records if record.ok]
    x = np.linspace(0.0, 1.0, points)
    records, rows = [], []
    for k in range(number):
        record = replace(good[k % len(good)], key=f"k{k}", diagnostics={f"figure {i}": 1 / (i + 3) for i in range(20)})
        if k % every_failed == 0:
            long = "x" * 10_000
            records.append(as_failed(record, f"{long}\n{LOG_TITLE}\n{long}", long))
        else:
            line = Interface.polyline(np.stack([x, 0.1 * x**2 + 1e-4 * k / 7], axis=1))
            records.append(replace(record, interfaces={"": line}))
            rows.append(k % len(good))
    return with_runs(calibration, records, rows)


def test_the_page_holds_the_runs_as_they_are_and_the_posterior(beam: Finished, calibration: Calibration) -> None:
    data = data_in((beam.folder / "report.html").read_text("utf-8"))
    runs, records = data["runs"], calibration.all_runs
    assert runs["row"] == list(range(len(records)))
    assert runs["state"] == [record.state for record in records]
    for name in calibration.problem.space.names:
        assert runs["inputs"][name] == pytest.approx([record.inputs[name] for record in records], rel=1e-5)
    (seen,) = calibration.problem.observations
    assert len(data["interfaces"]) == len(records)
    for row in (0, 17):
        own, found = records[row].interfaces[""], data["interfaces"][str(row)][""]
        assert np.allclose(np.transpose(found["line"]), own.points, atol=1e-6)
        off = 1e3 * signed_distances(seen.interface.points, own)
        assert found["offsets"] == pytest.approx(off.tolist(), rel=1e-3)
    assert np.allclose(np.transpose(data["facts"]["conditions"][0]["observed"]), seen.interface.points, atol=1e-6)
    assert data["facts"]["fixed"] == pytest.approx(dict(calibration.problem.fixed))
    posterior = data["posterior"]
    for name, item in beam.outcome.summary["inputs"].items():
        draws, moments = posterior["draws"][name], (posterior["mean"][name], posterior["sd"][name])
        assert moments == pytest.approx((item["mean"], item["sd"]))
        assert len(draws) == 2000
        assert float(np.mean(draws)) == pytest.approx(item["mean"], abs=0.1 * item["sd"])
        assert float(np.std(draws)) == pytest.approx(item["sd"], rel=0.1)
    line, band = (np.array(posterior["bands"][""][name]) for name in ("line", "band"))
    upper, lower = band[:, : line.shape[1]], band[:, line.shape[1] :][:, ::-1]
    assert np.allclose((upper + lower) / 2, line, atol=2e-6)
    assert (np.linalg.norm(upper - lower, axis=0)[1:] > 0).all()


def test_a_failure_is_shown_with_its_message_and_log(calibration: Calibration) -> None:
    records = list(calibration.records)
    message = f"no </script> here\n{LOG_TITLE}\nlast"
    records[3] = as_failed(records[3], message, "\n".join(map(str, range(50))))
    found = explore(with_runs(calibration, records, [k for k in range(len(records)) if k != 3]), None)
    assert "<" not in found.data
    data: Any = json.loads(found.data)
    assert (data["runs"]["state"][3], data["runs"]["kind"][3]) == ("failed", "</script><b>")
    assert data["details"]["3"]["message"] == "no </script> here"
    assert data["details"]["3"]["log"].splitlines() == [str(k) for k in range(42, 50)]
    assert "3" not in data["interfaces"]
    assert found.outlines == len(records) - 1


def test_of_many_runs_the_best_and_some_of_all_are_kept(calibration: Calibration) -> None:
    other = many(calibration, 3000, points=17, every_failed=10)
    found = explore(other, None)
    data = json.loads(found.data)
    rows = data["runs"]["row"]
    assert (found.runs, found.of, found.outlines) == (1000, 3000, 200)
    assert rows == sorted(set(rows))
    values, used = next(iter(other.log_likelihoods.values())), [k for k in range(3000) if k % 10]
    best = [used[i] for i in np.argsort(-values, kind="stable")]
    assert set(best[:500]) <= set(rows)
    assert {str(row) for row in best[:100]} <= set(data["interfaces"])
    assert max(np.diff(rows)) < 40
    assert 20 < data["runs"]["state"].count("failed") < 300
    assert set(data["interfaces"]) <= {str(row) for row in rows}


def test_the_data_stay_small_whatever_a_run_returns(calibration: Calibration) -> None:
    """Long messages and logs, many figures, fine interfaces and observations of a thousand points."""
    (seen,) = calibration.problem.observations
    x = np.linspace(0.0, 1.0, 1000)
    observed = replace(seen, interface=Interface.polyline(np.stack([x, 0.1 * x**2], axis=1)))
    other = many(calibration, 1500, points=1000, every_failed=3)
    found = explore(replace(other, problem=replace(other.problem, observations=(observed,))), None)
    data = json.loads(found.data)
    assert all(len(one[""]["line"][0]) <= 100 for one in data["interfaces"].values())
    assert len(data["interfaces"]) == section.MOST_NUMBERS // 1200
    assert found.size < 2_200_000
