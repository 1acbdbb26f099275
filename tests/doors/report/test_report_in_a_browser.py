"""A person opens report.html from the disk, at both widths, light and dark, with and without scripts, and prints it.

Nothing is asked of a machine, the console stays empty, and axe-core finds no fault in the section.
"""

import base64
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tests.study.conftest import Finished, finish
from tests.unit.studies.hump import height, picture, seen

axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs the package axe-playwright-python")

POINTS = "#pair-plot .scatterlayer .points path"


class Reader:
    """Somebody who reads a report, and notices what a page must not do."""

    def __init__(self, browser: Any, path: Any, *, width: int = 1280, colours: Any = "light", scripts: bool = True):
        self.context = browser.new_context(
            viewport={"width": width, "height": 900}, color_scheme=colours, java_script_enabled=scripts
        )
        self.page, self.faults = self.context.new_page(), []
        self.page.on("console", lambda message: self.faults.append(message.text))
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("request", lambda request: self._note(request.url))
        self.page.goto(path.as_uri())
        if scripts:
            self.page.wait_for_selector(POINTS)

    def _note(self, url: str) -> None:
        if not re.match(r"(file|data|blob):", url):
            self.faults.append(f"asked elsewhere: {url}")

    def waits_for(self, what: Callable[[], bool], seconds: float = 10.0) -> None:
        for _ in range(round(seconds / 0.05)):
            if what():
                return
            self.page.wait_for_timeout(50)
        raise AssertionError("it did not happen")

    def goes_to(self, key: str, selector: str, row: str) -> None:
        self.page.press(selector, key)
        self.waits_for(lambda: self.page.input_value("#run-row") == row)

    def leaves(self) -> None:
        assert self.faults == []
        self.context.close()


def clicked_row(reader: Reader, number: int) -> int:
    """Click on a point of the plot, and return the row of its run."""
    reader.page.locator("#pair-plot").scroll_into_view_if_needed()
    box = reader.page.locator(POINTS).nth(number).bounding_box()
    place = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    reader.page.mouse.move(*place)
    reader.page.mouse.click(*place)
    reader.waits_for(lambda: reader.page.input_value("#run-row") != "")
    return int(reader.page.input_value("#run-row")) - 1


@pytest.mark.parametrize(("width", "colours"), [(1280, "light"), (400, "dark")])
def test_a_click_on_a_run_shows_its_inputs_and_its_interface(
    width: int, colours: str, browser: Any, reported: Finished
) -> None:
    reader = Reader(browser, reported.outcome.report, width=width, colours=colours)
    records = reported.outcome.calibration.all_runs
    assert reader.page.locator(POINTS).count() == len(records)
    assert reader.page.locator("#pair-plot .contourlayer path, #pair-plot .contour path").count() > 0
    assert reader.page.locator("#densities .plot").count() == 2
    row = clicked_row(reader, 5)
    record = records[row]
    reader.waits_for(lambda: f"run {row + 1}" in reader.page.inner_text("#shape-note"))
    for name, value in record.inputs.items():
        shown = re.search(rf"\b{name} = (\S+?)(,|$)", reader.page.inner_text("#run-text"), re.M)
        assert shown is not None
        assert float(shown[1]) == pytest.approx(value, rel=1e-5)
    drawn = reader.page.locator("#shape-plot").evaluate(f"(e) => e.data.find((t) => t.name === 'run {row + 1}').y")
    assert np.allclose(drawn, record.interfaces[""].points[:, 1], atol=1e-6)
    assert reader.page.evaluate("document.documentElement.scrollWidth") <= width
    found = axe.Axe().run(reader.page, context=".explore").response["violations"]
    assert [(one["id"], [node["html"] for node in one["nodes"]][:2]) for one in found] == []
    reader.leaves()


def test_the_keyboard_goes_through_the_runs_and_paper_shows_the_figures_alone(browser: Any, reported: Finished) -> None:
    reader = Reader(browser, reported.outcome.report)
    shown = [text.split("±") for text in reader.page.locator("#moments tbody td:nth-child(3)").all_inner_texts()]
    for (mean, sd), item in zip(shown, reported.outcome.summary["inputs"].values(), strict=True):
        assert float(mean) == pytest.approx(item["mean"], abs=0.05 * item["sd"])
        assert float(sd) == pytest.approx(item["sd"], rel=0.05)
    for asked, row in (("9999", "32"), ("0", "1"), ("7", "7")):
        reader.page.fill("#run-row", asked)
        reader.goes_to("Enter", "#run-row", row)
    reader.goes_to("Enter", "#run-on", "8")
    reader.goes_to("Enter", "#run-back", "7")
    reader.page.select_option("#pair-y", label="E")
    reader.waits_for(lambda: "time [s]" in str(reader.page.text_content("#pair-plot")))
    there = (".explore", "nav a[href='#explore']")
    assert all(reader.page.is_visible(one) for one in there)
    reader.page.emulate_media(media="print")
    assert not reader.page.is_visible(".explore")
    assert reader.page.is_visible("h2#provenance")
    assert reader.page.is_visible("figure img")
    reader.leaves()


def test_without_scripts_the_rest_is_there(browser: Any, reported: Finished) -> None:
    reader = Reader(browser, reported.outcome.report, scripts=False)
    for hidden in (".explore", "#pair-x", "nav a[href='#explore']"):
        assert not reader.page.is_visible(hidden)
    assert reader.page.locator("figure img").count() == 11
    for section in ("asked", "fit", "answer", "data", "runs", "surrogate", "sampler", "paper", "provenance"):
        assert reader.page.is_visible(f"h2#{section}")
    assert "Permission is hereby granted" not in reader.page.inner_text("body")
    reader.leaves()


def test_another_script_cannot_run(browser: Any, reported: Finished, tmp_path: Path) -> None:
    """Somebody adds a script to the page: the page's policy refuses it."""
    path = tmp_path / "report.html"
    page = (reported.folder / "report.html").read_text("utf-8")
    path.write_text(page.replace("</main>", "<script>document.title = 'changed';</script></main>"), encoding="utf-8")
    reader = Reader(browser, path)
    assert reader.page.title() != "changed"
    assert any("Content Security Policy" in fault for fault in reader.faults)
    reader.context.close()


def test_the_edge_lies_on_the_picture_in_the_page(browser: Any, tmp_path: Path) -> None:
    """The report shows the photograph behind the interfaces, as the live page does, without a request."""
    picture(tmp_path)
    noise = {"sd": "image", "unit": "um", "unknown": {"shift": 5}}
    study = finish(tmp_path, observation=seen(), discrepancy={"normal_offset": {}}, noise=noise)
    reader = Reader(browser, study.outcome.report)
    reader.page.wait_for_selector("#shape-plot .layer-below image, #shape-plot image")
    drawn = reader.page.locator("#shape-plot")
    x, y = np.array(
        drawn.evaluate("(e) => { const one = e.data.find((t) => t.name === 'observed'); return [one.x, one.y]; }")
    )
    assert np.abs(y - height(x)).max() < 1.5
    assert np.abs(y + 5 - height(x)).max() > 1.5, "planted: five pixels lower"
    image = drawn.evaluate("(e) => e.layout.images[0]")
    assert image["source"].startswith("data:image/jpeg;base64,")
    assert (image["sizex"], image["sizey"]) == (220, 160)
    grey = np.asarray(Image.open(io.BytesIO(base64.b64decode(image["source"].partition(",")[2]))), float)
    above, below = (grey[np.round(y + off).astype(int), np.round(x).astype(int)].mean() for off in (-6, 6))
    assert abs(above - below) > 60
    reader.leaves()
