"""A person opens report.html from the disk, at both widths, light and dark, with and without scripts, and prints it."""

import base64
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tests.doors.reader import POINTS, SCREENS, Reader, moments
from tests.study.conftest import Finished, finish
from tests.unit.studies.hump import height, picture, seen


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    measures = [{"tracked_points": {}}, {"closest_point": {}}]
    return finish(tmp_path_factory.mktemp("reported") / "beam", discrepancy=measures, design={"sobol": {"runs": 32}})


def reading(browser: Any, path: Path, ready: str = POINTS, **options: Any) -> Reader:
    return Reader(browser, path.as_uri(), ready=ready, **options)


@pytest.mark.parametrize(("width", "colours"), SCREENS)
def test_a_click_shows_a_run_and_its_interface(width: int, colours: str, browser: Any, reported: Finished) -> None:
    reader = reading(browser, reported.outcome.report, width=width, colours=colours)
    records = reported.outcome.calibration.all_runs
    assert reader.page.locator(POINTS).count() == len(records)
    assert reader.page.locator("#pair-plot .contourlayer path, #pair-plot .contour path").count() > 0
    row = reader.clicks_on_point(5)
    reader.waits_for(lambda: f"run {row + 1}" in reader.text("#shape-note"))
    for name, value in records[row].inputs.items():
        shown = re.search(rf"\b{name} = (\S+?)(,|$)", reader.text("#run-text"), re.M)
        assert shown is not None
        assert float(shown[1]) == pytest.approx(value, rel=1e-5)
    np.testing.assert_allclose(reader.drawn(f"run {row + 1}").T, records[row].interfaces[""].points, atol=1e-6)
    reader.sees_no_fault(".explore")
    reader.leaves()


def test_the_keyboard_goes_through_the_runs_paper_and_no_scripts_show_the_rest(
    browser: Any, reported: Finished
) -> None:
    reader = reading(browser, reported.outcome.report)
    shown = map(moments, reader.page.locator("#moments tbody td:nth-child(3)").all_inner_texts())
    for (mean, sd), item in zip(shown, reported.outcome.summary["inputs"].values(), strict=True):
        assert mean == pytest.approx(item["mean"], abs=0.05 * item["sd"])
        assert sd == pytest.approx(item["sd"], rel=0.05)
    for asked, row in (("9999", "32"), ("0", "1")):
        reader.page.fill("#run-row", asked)
        reader.goes_to("Enter", "#run-row", row)
    reader.goes_to("Enter", "#run-on", "2")
    assert all(map(reader.page.is_visible, (".explore", "nav a[href='#explore']")))
    reader.page.emulate_media(media="print")
    visible = [reader.page.is_visible(one) for one in (".explore", "h2#provenance", "figure img")]
    assert visible == [False, True, True]
    reader.leaves()
    reader = reading(browser, reported.outcome.report, "figure img", scripts=False)
    visible = [reader.page.is_visible(one) for one in (".explore", "h2#provenance", "figure img")]
    assert visible == [False, True, True]
    reader.leaves()


def test_the_edge_lies_on_the_picture_in_the_page(browser: Any, tmp_path: Path) -> None:
    """The report shows the photograph behind the interfaces, as the live page does, without a request."""
    picture(tmp_path)
    noise = {"sd": "image", "unit": "um", "unknown": {"shift": 5}}
    study = finish(tmp_path, observation=seen(), discrepancy={"normal_offset": {}}, noise=noise)
    reader = reading(browser, study.outcome.report)
    reader.page.wait_for_selector("#shape-plot .layer-below image, #shape-plot image")
    x, y = reader.drawn("observed")
    assert np.abs(y - height(x)).max() < 1.5
    image = reader.page.locator("#shape-plot").evaluate("(e) => e.layout.images[0]")
    assert image["source"].startswith("data:image/jpeg;base64,")
    assert (image["sizex"], image["sizey"]) == (220, 160)
    grey = np.asarray(Image.open(io.BytesIO(base64.b64decode(image["source"].partition(",")[2]))), float)
    above, below = (grey[np.round(y + off).astype(int), np.round(x).astype(int)].mean() for off in (-6, 6))
    assert abs(above - below) > 60
    reader.leaves()
