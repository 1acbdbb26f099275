"""A person's whole way in a real browser: from the page to a saved file whose coordinates are the places clicked on.

The picture holds bright dots at known pixels. A test finds them on screenshots, so that nothing of the page's own
conversion between screen and picture is used, and clicks there.
"""

import io
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage
from tests.doors.reader import Reader
from tests.unit.studies.hump import height, off, written

from strandline.cli import main
from strandline.errors import InvalidInput
from strandline.imaging.clicks import Clicks
from strandline.imaging.clicks_file import as_json, read_clicks
from strandline.report.click_page import click_page
from strandline.studies import load_study

playwright = pytest.importorskip("playwright.sync_api", reason="needs the package playwright")

SHA = "0123456789abcdef" * 4
WIDTH, HEIGHT = 640, 480
DOTS = np.array([(x, y) for y in range(60, 480, 90) for x in range(50, 640, 90)], dtype=float)
DOTS += np.arange(len(DOTS))[:, None] * [1, 2] % 7
"""Pixels (x, y) of the dots, row by row, a few pixels off a grid."""
EXACT = 1e-3
"""Error, in pixels, of clicks where a pixel of the picture fills one of the screen."""
READY = "Ready to save."
ONE_TO_ONE = "One pixel of the picture on one of the screen"


class Person(Reader):
    """Somebody who sees the page, points and types."""

    def __init__(self, browser: Any, path: Path) -> None:
        super().__init__(browser, path.as_uri(), ready="#stage[data-ready]")
        self.page.set_viewport_size({"width": 1280, "height": 800})
        self.downloads, self.keys = [], self.page.keyboard
        self.page.on("download", lambda download: self.downloads.append(download))

    def shot(self) -> tuple[Any, Any]:
        """Return a screenshot of the picture without marks, and where its top left corner is on the screen."""
        self.page.wait_for_timeout(80)
        box = self.page.locator("#picture").bounding_box()
        left, top = np.ceil([box["x"], box["y"]]).astype(int)
        shot = self.page.screenshot(style="#marks { visibility: hidden }")
        light = np.asarray(Image.open(io.BytesIO(shot)).convert("L")).astype(float)
        shown = light[top : int(box["y"] + box["height"]), left : int(box["x"] + box["width"])]
        return shown, np.array([left, top])

    def seen(self) -> Any:
        """Return where the dots are on the screen, as pixels (x, y) of a screenshot of the picture."""
        light, corner = self.shot()
        light = np.where(light > 70, light - 70, 0.0)
        spots, _ = ndimage.label(light)
        rim = {*spots[0], *spots[-1], *spots[:, 0], *spots[:, -1]}
        whole = [k for k in range(1, spots.max() + 1) if k not in rim]
        return np.array(ndimage.center_of_mass(light, spots, whole))[:, ::-1] + corner

    def places(self) -> Any:
        """Return where each dot is on the screen while all are visible: they lie in rows."""
        found = self.seen()
        assert len(found) == len(DOTS)
        rows = found[np.argsort(found[:, 1])].reshape(5, 7, 2)
        return np.concatenate([row[np.argsort(row[:, 0])] for row in rows])

    def sees_the_edge(self) -> Any:
        """Return places on the screen, from left to right, where bright turns into dark from above to below."""
        light, corner = self.shot()
        light = ndimage.gaussian_filter(light, 2.0)
        columns = np.linspace(0.06, 0.94, 7) * light.shape[1]
        rows = [np.flatnonzero(light[:, int(column)] > 120)[-1] for column in columns]
        return np.stack([columns, rows], axis=1) + corner

    def choose(self, label: str) -> None:
        self.page.get_by_role("radio", name=label).check()

    def click(self, *places: Any) -> None:
        for place in places:
            self.page.mouse.click(*np.round(place))

    def drag(self, start: Any, *places: Any) -> None:
        self.page.mouse.move(*np.round(start))
        self.page.mouse.down()
        for place in places:
            self.page.mouse.move(*np.round(place), steps=4)
        self.page.mouse.up()

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def click_closely(self, dot: int) -> None:
        """Zoom in on a dot with the wheel, click on it, and return to the whole picture."""
        place = self.places()[dot]
        self.page.mouse.move(*np.round(place))
        for _ in range(5):
            self.page.mouse.wheel(0, -100)
        near = self.seen()
        self.click(near[np.argmin(np.linalg.norm(near - place, axis=1))])
        self.keys.press("0")

    def save(self, folder: Path) -> Path:
        with self.page.expect_download() as download:
            self.page.get_by_role("button", name="Save").click()
        path = folder / download.value.suggested_filename
        download.value.save_as(path)
        return path

    def refusal(self) -> str:
        """Press Save, which must not save, and return what the page says."""
        before = len(self.downloads)
        self.page.get_by_role("button", name="Save").click()
        self.page.wait_for_timeout(150)
        assert len(self.downloads) == before
        return str(self.page.get_by_role("alert").inner_text())

    def hand_in(self, content: Any) -> None:
        """Open a file of clicks with these contents."""
        text = content if isinstance(content, str) else json.dumps(content)
        file = {"name": "scan.path.json", "mimeType": "application/json", "buffer": text.encode()}
        self.page.locator("#file").set_input_files(file)
        playwright.expect(self.page.get_by_role("status")).to_contain_text("pened")


Opened = Callable[[Path], Person]


@pytest.fixture
def opened(browser: Any) -> Iterator[Opened]:
    people: list[Person] = []

    def opened(path: Path) -> Person:
        people.append(Person(browser, path))
        return people[-1]

    yield opened
    for one in people:
        one.leaves()


def page_of_dots(folder: Path, **options: Any) -> Path:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    values = sum(np.exp(-((x - column) ** 2 + (y - row) ** 2) / (2 * 1.5**2)) for column, row in DOTS)
    (folder / "scan.html").write_text(click_page(values, name="scan.tif", sha256=SHA, **options), encoding="utf-8")
    return folder / "scan.html"


@pytest.fixture
def person(opened: Opened, tmp_path: Path) -> Person:
    return opened(page_of_dots(tmp_path))


def distance(found: Any, dots: list[int]) -> float:
    return float(np.linalg.norm(np.asarray(found) - DOTS[dots], axis=1).max())


def test_from_the_picture_to_the_saved_file(person: Person, tmp_path: Path) -> None:
    person.press(ONE_TO_ONE)
    places = person.places()
    assert person.text("#zoom") == "100 %"
    np.testing.assert_allclose(places[-1] - places[0], DOTS[-1] - DOTS[0], atol=0.1)

    person.choose("Scale bar")
    person.click(*places[[0, 6]])
    person.keys.type("250")  # the field of the length has the focus
    person.page.get_by_label("Unit of the length").select_option("µm")
    person.choose("Origin")
    person.click(places[20])

    person.choose("Path")
    person.keys.press("0")
    for dot in (7, 9, 17):
        person.click_closely(dot)
    near = person.places()
    person.click(near[34])
    person.keys.press("Control+z")  # that was the wrong dot
    assert person.text("#of-path") == "3 points"
    person.click(near[26])
    person.drag(near[26], near[19] + [40, 3], near[19])  # nor is this one, but it can be dragged

    person.press(ONE_TO_ONE)
    person.choose("Leave out")
    places = person.places()
    person.click(*places[[3, 4, 11, 3]])  # the first corner again finishes the region
    person.click(*places[[5, 13, 12]])
    person.keys.press("Enter")
    person.choose("Fixed region")
    person.click(*places[[28, 30, 22]])
    person.keys.press("Enter")
    assert person.text("#ready") == READY
    path = person.save(tmp_path)
    assert path.name == "scan.path.json"

    clicks = read_clicks(path)
    clicks.require_picture(SHA, (WIDTH, HEIGHT))
    assert (clicks.image, clicks.closed, clicks.scale.length_mm) == ("scan.tif", False, 0.25)
    assert clicks.pixel_mm == pytest.approx(0.25 / np.linalg.norm(DOTS[6] - DOTS[0]), rel=1e-6)
    assert distance([clicks.scale.start, clicks.scale.end], [0, 6]) <= EXACT
    assert distance([clicks.origin], [20]) <= EXACT
    assert distance(clicks.path[:3], [7, 9, 17]) <= 0.1  # zoomed by the wheel
    assert distance(clicks.path[3:], [19]) <= 0.5  # the whole picture at 145 %
    assert [len(corners) for corners in clicks.exclude] == [3, 3]
    assert distance(np.concatenate(clicks.exclude), [3, 4, 11, 5, 13, 12]) <= EXACT
    assert distance(np.concatenate(clicks.fixed), [28, 30, 22]) <= EXACT


def test_a_study_finds_the_edge_from_what_was_clicked(opened: Opened, tmp_path: Path, capsys: Any) -> None:
    """Somebody clicks where the grey value changes on the screen; the study takes the file as it was saved."""
    study = written(tmp_path / "s", path="hump.path.json")
    main(["image", str(study), "--edit"])
    person = opened(study / "hump.mark.html")
    person.choose("Path")
    person.click(*person.sees_the_edge())
    assert person.text("#ready") == READY
    assert person.save(study).name == "hump.path.json"
    clicked = read_clicks(study / "hump.path.json").path
    assert np.abs(clicked[:, 1] - height(clicked[:, 0])).max() < 2.0
    assert np.ptp(clicked[:, 0]) > 150
    loaded = load_study(study)
    assert abs(off(loaded).mean()) < 0.05
    assert len(loaded.observed[""].points) > 140
    main(["image", str(study)])
    assert "hump.png: edge of" in capsys.readouterr().out
    assert (study / "image" / "edge.csv").is_file()


@pytest.mark.smoke
def test_a_saved_file_is_loaded_and_saved_again_digit_by_digit(opened: Opened, tmp_path: Path) -> None:
    path, corners = np.array([[10.123, 1 / 3], [200.5, 30.0], [639.5, 479.5]]), [[0.1, 0.2], [5.0, 0.7], [3.0, 9.0]]
    exclude = (np.array(corners),)
    clicks = Clicks("scan.tif", SHA, (WIDTH, HEIGHT), path, closed=True, origin=(-20.5, 800.0), exclude=exclude)
    first = opened(page_of_dots(tmp_path, clicks=clicks)).save(tmp_path)
    assert as_json(read_clicks(first)) == as_json(clicks)
    text = first.read_text()
    person = opened(page_of_dots(tmp_path))
    person.hand_in(text)
    assert person.save(tmp_path).read_text() == text


def test_undo_and_redo_lead_back_and_forth(person: Person) -> None:
    """Then brightness changes the picture only on the screen."""
    person.click(*person.places()[[0, 6, 20]])
    closed = person.page.get_by_label("closed")
    closed.check()
    person.keys.press("Escape")
    seen = []
    for _ in range(4):
        seen.append((person.text("#of-path"), closed.is_checked()))
        person.press("Undo")
    assert seen == [("3 points", True), ("3 points", False), ("2 points", False), ("1 point", False)]
    assert person.text("#of-path") == "–"
    assert person.page.get_by_role("button", name="Undo").is_disabled()
    for _ in range(4):
        person.press("Redo")
    assert (person.text("#of-path"), closed.is_checked()) == ("3 points", True)
    dark, brightness = person.shot()[0], person.page.get_by_label("Brightness", exact=True)
    brightness.fill("300")
    assert person.shot()[0].mean() > 1.2 * dark.mean()
    person.press("Reset brightness and contrast")
    assert brightness.input_value() == "100"


@pytest.mark.smoke
def test_points_are_inserted_deleted_and_moved_by_keys(person: Person, tmp_path: Path) -> None:
    """And a scale bar and the view are drawn by dragging."""
    person.press(ONE_TO_ONE)
    places = person.places()
    person.click(*places[[0, 6, 34]])
    person.drag((places[0] + places[6]) / 2, places[10])
    person.click(places[6])
    person.keys.press("Delete")
    person.page.mouse.move(*np.round(places[28]))
    for key in ("a", "ArrowLeft", "ArrowLeft", "ArrowUp", "Shift+ArrowUp"):
        person.keys.press(key)
    found = read_clicks(person.save(tmp_path)).path
    assert distance(found[:3], [0, 10, 34]) <= EXACT
    np.testing.assert_allclose(found[3], DOTS[28] - [2, 11], atol=EXACT)
    person.choose("Scale bar")
    person.drag(places[0], places[6])
    person.page.get_by_role("spinbutton", name="Length").fill("2")
    per_pixel = float(person.text("#of-scale").removesuffix(" µm/px"))
    assert per_pixel == pytest.approx(2000 / np.linalg.norm(DOTS[6] - DOTS[0]), rel=5e-3)
    person.sees_no_fault()
    person.choose("Move the picture")
    person.drag(places[20], places[20] + [30, -20])
    np.testing.assert_allclose(person.places(), np.add(places, [30, -20]), atol=0.1)


def test_the_coordinates_are_those_of_the_whole_picture(opened: Opened, tmp_path: Path) -> None:
    """The page shows a pixel for nine, and each twice as wide as high."""
    person = opened(page_of_dots(tmp_path, pixel_mm=(0.004, 0.002), most_pixels=40_000))
    places = person.places()
    zoom = float(person.text("#zoom").removesuffix(" %")) / 100
    np.testing.assert_allclose(places[-1] - places[0], (DOTS[-1] - DOTS[0]) * [zoom, zoom / 2], rtol=0.01)
    person.click(*places[[0, 6, 34]])
    clicks = read_clicks(person.save(tmp_path))
    assert clicks.size == (WIDTH, HEIGHT)
    assert (np.abs(clicks.path - DOTS[[0, 6, 34]]) < [0.6, 1.1]).all()  # half as many pixels of the screen in y


def test_what_is_unfinished_cannot_be_saved(person: Person, tmp_path: Path) -> None:
    places = person.places()
    person.click(*places[[0, 13, 7]])
    person.choose("Scale bar")
    person.click(places[20])
    assert "The scale bar has one end" in person.refusal()
    person.click(places[27])
    assert "The scale bar has no length" in person.refusal()
    person.page.get_by_role("spinbutton", name="Length").fill("3")
    person.choose("Leave out")
    person.click(*places[[3, 4]])
    assert "Region 1 to leave out has 2 corners" in person.refusal()
    person.press("Delete region 1")
    clicks = read_clicks(person.save(tmp_path))
    assert (len(clicks.path), clicks.exclude) == (3, ())


GOOD: dict[str, Any] = {
    "version": 1, "image": "scan.tif", "sha256": SHA, "size": [WIDTH, HEIGHT], "path": [[10, 10], [90, 30], [40, 80]],
}  # fmt: skip
BAR = {"from": [1, 1], "to": [50, 1], "length_mm": 1}
CORNERS = [[1, 1], [9, 1], [9, 9]]
REPAIRABLE: list[tuple[dict[str, Any], str]] = [
    ({"path": []}, "The path has no points"),
    ({"path": [[1, 1], [2, 2]]}, "The path has 2 points"),
    ({"path": [[1, 1], [700, 2], [3, 3]]}, "Point 2 of the path is outside the picture"),
    ({"path": [[1, 1], [5, 2], [9, 7], [1, 1]], "closed": True}, "Points 4 and 1 of the path coincide"),
    ({"path": [[10, 10], [20, 20], [20, 10], [10, 20]]}, "crosses or touches itself near x 15.0, y 15.0"),
    ({"scale": {**BAR, "to": [1, 1]}}, "ends of the scale bar coincide"),
    ({"scale": {**BAR, "to": [1, 481]}}, "The scale bar reaches outside"),
    ({"scale": {**BAR, "length_mm": 0}}, "The scale bar has no length"),
    ({"exclude": [CORNERS, CORNERS[:2]]}, "Region 2 to leave out has 2 corners"),
    ({"fixed": [[[1, 1], [9, 1], [9, 999]]]}, "Region 1 that is fixed reaches outside"),
]
NOT_OPENED: list[tuple[Any, str]] = [
    ("{", "it is not JSON"),
    ([], "it is no file of clicks"),
    ({**GOOD, "version": 2}, "its version is 2"),
    ({**GOOD, "sha256": SHA[::-1]}, "another picture"),
    ({**GOOD, "size": [HEIGHT, WIDTH]}, "another picture"),
    ({**GOOD, "path": [[1, 2, 3]]}, "its path is no list of points"),
    ({**GOOD, "closed": 1}, "closed is neither true nor false"),
    ({**GOOD, "origin": [1]}, "its origin is no point"),
    ({**GOOD, "scale": {"from": [1, 1]}}, "its scale bar has no two ends"),
    ({**GOOD, "exclude": [[1, 2]]}, "its regions are no lists of corners"),
]


def test_the_page_refuses_what_the_reader_refuses(person: Person, tmp_path: Path) -> None:
    path = tmp_path / "bad.path.json"
    for changes, message in REPAIRABLE:
        path.write_text(json.dumps({**GOOD, **changes}))
        with pytest.raises(InvalidInput):
            read_clicks(path)
        person.hand_in({**GOOD, **changes})
        assert message in person.refusal()
    for content, message in NOT_OPENED:
        person.hand_in(GOOD)
        person.hand_in(content)
        assert re.search(f"scan.path.json was not opened: .*{message}", person.page.get_by_role("alert").inner_text())
        assert person.text("#of-path") == "3 points"
    person.hand_in({**GOOD, "path": [], "fixed": [CORNERS]})  # enough to register another picture to this one
    assert person.text("#ready") == READY
    assert as_json(read_clicks(person.save(tmp_path)))["fixed"] == [CORNERS]


@pytest.mark.smoke
def test_page_and_reader_agree_on_paths_that_cross_or_touch(person: Person) -> None:
    """Of so few places that many paths repeat, touch or run back, and of any."""
    rng = np.random.default_rng(3)
    paths = [rng.integers(0, 7, (int(rng.integers(3, 8)), 2)).tolist() for _ in range(600)]
    paths += [(100 * rng.random((6, 2))).tolist() for _ in range(200)]
    cases = [(path, bool(rng.integers(2))) for path in paths]
    judge = (
        "(all) => all.map(([path, closed]) => { marks = { ...nothing(), path, closed }; return !problems().length; })"
    )
    expected = [_is_path(points, closed) for points, closed in cases]
    assert person.page.evaluate(judge, cases) == expected
    assert 100 < sum(expected) < 700


def _is_path(points: Any, closed: bool) -> bool:
    try:
        Clicks("scan.tif", SHA, (WIDTH, HEIGHT), np.array(points, dtype=float), closed=closed)
    except InvalidInput:
        return False
    return True
