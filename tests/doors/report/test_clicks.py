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

from strandline.foundations import InvalidInput
from strandline.imaging.clicks import Clicks, as_json, read_clicks
from strandline.report.page import click_page

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

    def seen(self) -> Any:
        """Return where the dots are on the screen, as pixels (x, y) of a screenshot of the picture without marks."""
        self.page.wait_for_timeout(80)
        box = self.page.locator("#picture").bounding_box()
        left, top = np.ceil([box["x"], box["y"]]).astype(int)
        shot = self.page.screenshot(style="#marks { visibility: hidden }")
        light = np.asarray(Image.open(io.BytesIO(shot)).convert("L")).astype(float)
        light = light[top : int(box["y"] + box["height"]), left : int(box["x"] + box["width"])]
        light = np.where(light > 70, light - 70, 0.0)
        spots, _ = ndimage.label(light)
        rim = {*spots[0], *spots[-1], *spots[:, 0], *spots[:, -1]}
        whole = [k for k in range(1, spots.max() + 1) if k not in rim]
        return np.array(ndimage.center_of_mass(light, spots, whole))[:, ::-1] + [left, top]

    def places(self) -> Any:
        """Return where each dot is on the screen while all are visible: they lie in rows."""
        found = self.seen()
        assert len(found) == len(DOTS)
        rows = found[np.argsort(found[:, 1])].reshape(5, 7, 2)
        return np.concatenate([row[np.argsort(row[:, 0])] for row in rows])

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
    for key, number in (("Control+z", 3), ("Control+y", 4), ("Control+z", 3)):  # that was the wrong dot
        person.keys.press(key)
        assert person.text("#of-path") == f"{number} points"
    person.click(near[26])
    person.drag(near[26], near[19] + [40, 3], near[19])  # nor is this one, but it can be dragged

    person.press(ONE_TO_ONE)
    person.choose("Leave out")
    places = person.places()
    person.click(*places[[3, 4, 11, 3]])  # the first corner again finishes the region
    person.choose("Fixed region")
    person.click(*places[[28, 30, 22]])
    person.keys.press("Enter")
    path = person.save(tmp_path)
    assert path.name == "scan.path.json"

    clicks = read_clicks(path)
    clicks.require_picture(SHA, (WIDTH, HEIGHT))
    assert (clicks.image, clicks.closed, clicks.scale.length_mm) == ("scan.tif", False, 0.25)
    assert distance([clicks.scale.start, clicks.scale.end], [0, 6]) <= EXACT
    assert distance([clicks.origin], [20]) <= EXACT
    assert distance(clicks.path[:3], [7, 9, 17]) <= 0.1  # zoomed by the wheel
    assert distance(clicks.path[3:], [19]) <= 0.5  # the whole picture at 145 %
    assert distance(np.concatenate(clicks.exclude), [3, 4, 11]) <= EXACT
    assert distance(np.concatenate(clicks.fixed), [28, 30, 22]) <= EXACT


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


@pytest.mark.smoke
def test_points_are_inserted_deleted_and_moved_by_keys(person: Person, tmp_path: Path) -> None:
    """And a scale bar is drawn by dragging, without which the file is not saved."""
    person.press(ONE_TO_ONE)
    places = person.places()
    person.click(*places[[0, 6, 34]])
    person.drag((places[0] + places[6]) / 2, places[10])
    person.click(places[6])
    person.keys.press("Delete")
    person.page.mouse.move(*np.round(places[28]))
    for key in ("a", "ArrowLeft", "ArrowLeft", "ArrowUp", "Shift+ArrowUp"):
        person.keys.press(key)
    person.choose("Scale bar")
    person.drag(places[0], places[6])
    assert "The scale bar has no length" in person.refusal()
    person.page.get_by_role("spinbutton", name="Length").fill("2")
    clicks = read_clicks(person.save(tmp_path))
    assert distance(clicks.path[:3], [0, 10, 34]) <= EXACT
    np.testing.assert_allclose(clicks.path[3], DOTS[28] - [2, 11], atol=EXACT)
    assert clicks.pixel_mm == pytest.approx(2 / np.linalg.norm(DOTS[6] - DOTS[0]), rel=5e-3)
    person.sees_no_fault()


def test_the_coordinates_are_those_of_the_whole_picture(opened: Opened, tmp_path: Path) -> None:
    """The page shows a pixel for nine, and each twice as wide as high."""
    person = opened(page_of_dots(tmp_path, pixel_mm=(0.004, 0.002), most_pixels=40_000))
    person.click(*person.places()[[0, 6, 34]])
    clicks = read_clicks(person.save(tmp_path))
    assert (np.abs(clicks.path - DOTS[[0, 6, 34]]) < [0.6, 1.1]).all()  # half as many pixels of the screen in y


GOOD: dict[str, Any] = {
    "version": 1, "image": "scan.tif", "sha256": SHA, "size": [WIDTH, HEIGHT], "path": [[10, 10], [90, 30], [40, 80]],
}  # fmt: skip
BAR = {"from": [1, 1], "to": [50, 1], "length_mm": 1}
CORNERS = [[1, 1], [9, 1], [9, 9]]
REPAIRABLE: list[tuple[dict[str, Any], str]] = [
    ({"path": [[1, 1], [2, 2]]}, "The path has 2 points"),
    ({"path": [[1, 1], [700, 2], [3, 3]]}, "Point 2 of the path is outside the picture"),
    ({"path": [[1, 1], [5, 2], [9, 7], [1, 1]], "closed": True}, "Points 4 and 1 of the path coincide"),
    ({"path": [[10, 10], [20, 20], [20, 10], [10, 20]]}, "crosses or touches itself near x 15.0, y 15.0"),
    ({"scale": {**BAR, "to": [1, 1]}}, "ends of the scale bar coincide"),
    ({"exclude": [CORNERS, CORNERS[:2]]}, "Region 2 to leave out has 2 corners"),
    ({"fixed": [[[1, 1], [9, 1], [9, 999]]]}, "Region 1 that is fixed reaches outside"),
]
NOT_OPENED: list[tuple[Any, str]] = [
    ("{", "it is not JSON"),
    ({**GOOD, "version": 2}, "its version is 2"),
    ({**GOOD, "sha256": SHA[::-1]}, "another picture"),
    ({**GOOD, "path": [[1, 2, 3]]}, "its path is no list of points"),
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


def is_path(points: Any, closed: bool) -> bool:
    try:
        Clicks("scan.tif", SHA, (WIDTH, HEIGHT), np.array(points, dtype=float), closed=closed)
    except InvalidInput:
        return False
    return True


@pytest.mark.smoke
def test_page_and_reader_agree_on_paths_that_cross_or_touch(person: Person) -> None:
    """Of so few places that many paths repeat, touch or run back, and of any."""
    rng = np.random.default_rng(3)
    paths = [rng.integers(0, 7, (int(rng.integers(3, 8)), 2)).tolist() for _ in range(600)]
    paths += [(100 * rng.random((6, 2))).tolist() for _ in range(200)]
    cases = [(path, bool(rng.integers(2))) for path in paths]
    judge = "marks = { ...nothing(), path, closed }; return !problems().length;"
    expected = [is_path(points, closed) for points, closed in cases]
    assert person.page.evaluate(f"(all) => all.map(([path, closed]) => {{ {judge} }})", cases) == expected
    assert 100 < sum(expected) < 700
