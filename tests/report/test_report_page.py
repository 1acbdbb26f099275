"""The report: self-contained, whole, with every figure and number."""

import base64
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from scipy import stats

from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import LogNormal
from strandline.report import write_report
from strandline.report.figures import figure_groups
from strandline.report.page import template
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
    "sensitivity",
    "tempering",
]
"""Of a model of two inputs that has no fields to show."""
SECTIONS = ["asked", "fit", "answer", "data", "runs", "surrogate", "sampler", "paper", "provenance", "explore"]
VOID = {"meta", "br", "img", "link", "hr", "input"}


class Page(HTMLParser):
    """Tags with their attributes, the visible text, and whether every tag is closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data

    def attributes(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def page(reported: Any) -> Page:
    return Page(reported.outcome.report.read_text())


def test_nothing_is_loaded_from_outside(page: Page) -> None:
    names = {tag for tag, _ in page.tags}
    assert names.isdisjoint({"link", "iframe", "object", "embed", "video", "audio"})
    for _, attributes in page.tags:
        for name in ("src", "href", "srcset", "data", "poster", "background"):
            assert re.match(r"#|data:image/png;base64,", attributes.get(name) or "#")
    assert not page.open


def test_the_policy_allows_the_pages_own_style_pictures_and_scripts_and_nothing_else(page: Page) -> None:
    (policy,) = [a["content"] for a in page.attributes("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    rules = dict(rule.strip().split(" ", 1) for rule in (policy or "").split(";"))
    assert (rules["default-src"], rules["img-src"], rules["style-src"]) == ("'none'", "data:", "'unsafe-inline'")
    data, shown = {"application/json", "application/gzip"}, page.attributes("script")
    assert [one.get("type") in data for one in shown] == [True, True, False]
    hashes = rules["script-src"].split()
    assert len(hashes) == 2
    assert all(re.fullmatch(r"'sha256-[A-Za-z0-9+/]{43}='", one) for one in hashes)
    tags = [tag for tag, _ in page.tags]
    assert tags.index("meta") < tags.index("style")


def test_the_style_loads_nothing(reported: Any) -> None:
    text = reported.outcome.report.read_text()
    style = text[text.index("<style>") : text.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style


def test_every_figure_is_in_the_page_and_in_the_folder(page: Page, reported: Any) -> None:
    images = page.attributes("img")
    ids = [attributes["id"] for attributes in page.attributes("figure")]
    assert sorted(str(name) for name in ids) == FIGURES
    for name, image in zip(ids, images, strict=True):
        data = base64.b64decode((image["src"] or "").partition(",")[2], validate=True)
        assert data[:8] == b"\x89PNG\r\n\x1a\n"
        assert data == (reported.folder / "figures" / f"{name}.png").read_bytes()
        assert (reported.folder / "figures" / f"{name}.pdf").read_bytes()[:5] == b"%PDF-"
        assert image["alt"]
    names = [path.name for path in (reported.folder / "figures").iterdir()]
    assert sorted(names) == sorted(f"{name}.{kind}" for name in FIGURES for kind in ("png", "pdf"))


def test_every_link_has_its_target(page: Page) -> None:
    targets = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert [attributes["href"] for attributes in page.attributes("a")] == [f"#{name}" for name in SECTIONS]
    assert set(SECTIONS) <= set(targets)
    assert len(set(targets)) == len(targets)


def test_the_numbers_are_those_of_the_summary(page: Page, reported: Any) -> None:
    summary = reported.outcome.summary
    for item in summary["inputs"].values():
        for figure in (item["mean"], item["median"], item["q05"], item["q95"], item["map"]):
            assert f"{figure:.4g}" in page.text
    for warning in summary["warnings"]:
        assert warning in page.text
    assert f"evidence {summary['log_evidence']:.5g}".replace("-", "−") in page.text
    assert "64 of 64 runs of the design succeeded" in page.text
    assert "closest point" in page.text
    assert "400 particles" in page.text
    for name, version in summary["versions"].items():
        assert f"{name} {version}" in page.text
    assert "test:beam-1" in page.text


def test_the_study_file_is_shown_and_escaped(page: Page, reported: Any) -> None:
    assert (reported.folder / "study.yaml").read_text() in page.text


def test_a_second_report_replaces_the_first_whole(reported: Any, tmp_path: Path) -> None:
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "old.png").touch()
    (tmp_path / ".figures.partial").mkdir()
    (tmp_path / ".figures.partial" / "flow.png").touch()
    outcome = reported.outcome
    path = write_report(outcome.calibration, outcome.summary, study_text="", truth=None, folder=tmp_path)
    assert path == tmp_path / "report.html"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["figures", "report.html"]
    assert sorted(p.stem for p in (tmp_path / "figures").glob("*.png")) == FIGURES


def test_a_figure_that_fails_leaves_the_old_report(
    reported: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "old.png").touch()

    def broken(*args: Any, **options: Any) -> Any:
        raise RuntimeError("no ink")

    monkeypatch.setattr("strandline.report.plots.plot_leave_one_out", broken)
    outcome = reported.outcome
    with pytest.raises(RuntimeError, match="no ink"):
        write_report(outcome.calibration, outcome.summary, study_text="", truth=None, folder=tmp_path)
    assert [p.name for p in tmp_path.rglob("*")] == ["figures", "old.png"]


def test_a_figure_that_fails_is_left_out_where_someone_hears_of_it(
    reported: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*args: Any, **options: Any) -> Any:
        raise RuntimeError("no ink")

    def two(*args: Any) -> Any:
        return {name: group for name, group in figure_groups(*args).items() if name in ("surrogate", "sampler")}

    heard: dict[str, Exception] = {}
    monkeypatch.setattr("strandline.report.page.figure_groups", two)
    monkeypatch.setattr("strandline.report.plots.plot_tempering", broken)
    outcome = reported.outcome
    page = write_report(
        outcome.calibration,
        outcome.summary,
        study_text="",
        truth=None,
        folder=tmp_path,
        on_failure=heard.__setitem__,
    )
    assert [(name, str(error)) for name, error in heard.items()] == [("figures (sampler)", "no ink")]
    text = page.read_text()
    assert "figures (sampler) could not be written: RuntimeError: no ink" in text
    drawn = ["leave_one_out", "sensitivity"]
    assert sorted(path.stem for path in (tmp_path / "figures").glob("*.png")) == drawn
    assert sorted(str(attributes["id"]) for attributes in Page(text).attributes("figure")) == drawn


def test_without_quadrature_truth_and_failures(reported: Any) -> None:
    """In more than three dimensions, with an observed file: the page leaves out what there is not."""
    summary = reported.outcome.summary
    seconds = {key: value for key, value in summary["seconds"].items() if key != "report"}
    bare = {**summary, "quadrature_check": None, "truth": None, "warnings": [], "seconds": seconds, "fixed": {}}
    failed = {**bare["runs"], "failed": 2, "by_kind": {"newton_stalled": 2}}
    page = template("report.html.j2")
    text = Page(page.render(s={**bare, "runs": failed}, figures=[], study_text="", check=None)).text
    assert "truth" not in text
    assert "Quadrature" not in text
    assert "No warnings" in text
    assert "newton_stalled" in text


@pytest.mark.parametrize(
    ("box", "told"), [((250.0, 650.0), "1.69%"), ((200.0, 850.0), "0.03%"), ((120.0, 900.0), "less than 0.01%")]
)
def test_the_mass_cut_off_is_the_same_in_table_and_warning_which_tells_no_trifles(
    reported: Any, box: tuple[float, float], told: str
) -> None:
    calibration = reported.outcome.calibration
    E = Parameter("E", LogNormal(6.0, 0.2), "Pa", box)
    low, high = ((math.log(end) - 6.0) / 0.2 for end in box)
    cut = stats.norm.cdf(low) + stats.norm.sf(high)
    assert told == (f"{cut:.2%}" if cut > 1e-4 else "less than 0.01%")
    space = ParameterSpace((E, calibration.problem.space["tilt"]))
    warned = find_warnings(replace(calibration, problem=replace(calibration.problem, space=space)))
    of_the_cut = [warning for warning in warned if "of its mass was cut off" in warning]
    assert len(of_the_cut) == (cut > 1e-3)
    assert all(f": {told} of its mass was cut off" in warning for warning in of_the_cut)
    summary = reported.outcome.summary
    inputs = summary["inputs"] | {"E": summary["inputs"]["E"] | {"prior_mass_cut": E.mass_cut}}
    page = template("report.html.j2")
    shown = Page(page.render(s=summary | {"inputs": inputs}, figures=[], study_text="", check=None, picture=None))
    assert f"300 … 560{told}" in shown.text
