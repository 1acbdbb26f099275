"""A person's whole way in a real browser: a campaign, one run, the sliders, another posterior, a new study.

What the page shows is compared with what the library computes. Nothing is asked of another machine, the console stays
empty, and axe-core finds no fault of contrast, labels or structure at either width, light or dark.
"""

import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.doors.view.conftest import SMALL
from tests.unit.studies.hump import height, written

import strandline as sl
from strandline.discrepancy.normal_offset import signed_distances
from strandline.studies.first_run import observations_of
from strandline.testing.studies import beam, write_study
from strandline.view import serving

axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs the package axe-playwright-python")

SLOW = """
import time
from strandline.errors import ForwardModelError
from strandline.testing.studies import beam as quick


def beam(inputs, workdir):
    time.sleep(0.15)
    if inputs["E"] > 520:
        raise ForwardModelError("too_stiff", "the beam is too stiff")
    return quick(inputs, workdir)
"""
"""A model with some time for a run, and failures."""
SCREENS = [(1280, "light"), (400, "dark")]


class Person:
    """Somebody who looks at the page, and notices what a page must not do."""

    def __init__(self, browser: Any, url: str, *, width: int = 1280, colours: str = "light") -> None:
        self.context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=colours)
        self.page, self.faults = self.context.new_page(), []
        self.page.on("console", lambda message: self.faults.append(message.text))
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("request", lambda request: self._note(request.url))
        self.page.goto(url)
        self.page.wait_for_selector("#counts div")

    def _note(self, url: str) -> None:
        if not re.match(r"(http://127\.0\.0\.1:\d+/|data:|blob:)", url):
            self.faults.append(f"asked elsewhere: {url}")

    def text(self, selector: str) -> str:
        return str(self.page.inner_text(selector))

    def sees_posterior(self) -> None:
        self.page.wait_for_selector("#moments td", timeout=30_000)

    def slides(self, selector: str, value: float) -> None:
        """Move a slider, and let go."""
        move = "(e, v) => { e.value = v; e.dispatchEvent(new Event('input')); e.dispatchEvent(new Event('change')); }"
        self.page.locator(selector).evaluate(move, value)

    def waits_for(self, what: Callable[[], Any], seconds: float = 10.0) -> None:
        end = time.monotonic() + seconds
        while not what():
            assert time.monotonic() < end, "it did not happen"
            self.page.wait_for_timeout(50)

    def leaves(self) -> None:
        assert self.faults == []
        self.context.close()


@pytest.fixture
def person(browser: Any, folder: Path) -> Iterator[Person]:
    with serving(sl.load_study(folder)) as server:
        found = Person(browser, server.url)
        found.sees_posterior()
        yield found
        found.leaves()


def test_a_campaign_while_it_runs(browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs appear within a second, the posterior takes shape, a failure is named; the page outlives the driver."""
    slow = {**SMALL, "design": {"sobol": {"runs": 40}}, "model": {"python": {"function": "slow_beam:beam"}}}
    folder = write_study(tmp_path / "beam", **slow)
    (folder / "slow_beam.py").write_text(SLOW)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=":")
    with serving(sl.load_study(folder)) as server:
        person = Person(browser, server.url)
        assert person.text("#status").startswith("0 of 40 runs done")
        assert "No forward run has been started yet." in person.text("#driver")
        driver = subprocess.Popen([sys.executable, "-m", "strandline", "run", str(folder), "--quiet"])
        lags = []
        for number in range(1, 12):
            _until(lambda number=number: _ended(server.viewed.study.ledger_path) > number)
            begun = time.monotonic()
            person.waits_for(lambda number=number: _count(person) >= number)
            lags.append(time.monotonic() - begun)
        assert float(np.median(lags)) < 1.0
        assert max(lags) < 2.5
        person.sees_posterior()
        assert "From the runs so far" in person.text("#posterior-source")
        assert "at work" in person.text("#driver")
        driver.kill()
        driver.wait()
        person.waits_for(lambda: re.search("has ended. Start it again|All runs are done", person.text("#driver")))
        subprocess.run([sys.executable, "-m", "strandline", "run", str(folder), "--quiet"], check=True, timeout=300)
        person.waits_for(lambda: "finished" in person.text("#status"))
        person.waits_for(lambda: "The study's own result" in person.text("#posterior-source"))
        person.page.click("#failures summary")
        assert "too stiff" in person.text("#failures")
        assert len(server.viewed.newest.shown.history) >= 3
        assert person.page.is_visible("#history-plot")
        person.leaves()


DATA_OF_PLOT = "() => document.getElementById('shape-plot').data.map(({ name, x, y }) => ({ name, x, y }))"


def test_the_edge_lies_on_the_picture_behind_it(browser: Any, tmp_path: Path) -> None:
    """The observed line is drawn in pixels, where the picture is bright on one side and dark on the other."""
    with serving(sl.load_study(written(tmp_path / "hump"))) as server:
        person = Person(browser, server.url)
        person.page.wait_for_selector("#shape-plot .layer-below image, #shape-plot image")
        (edge,) = (one for one in person.page.evaluate(DATA_OF_PLOT) if one["name"] == "observed")
        x, y = np.array(edge["x"]), np.array(edge["y"])
        assert np.abs(y - height(x)).max() < 1.5
        assert np.sqrt(np.mean((y - height(x)) ** 2)) < 0.4
        assert np.abs(y + 5 - height(x)).max() > 1.5  # planted: five pixels lower
        size = (
            "() => new Promise((done) => { const i = new Image(); i.onload = () => done([i.width, i.height]); i.src = "
        )
        source = person.page.evaluate("() => document.getElementById('shape-plot').layout.images[0].source")
        assert person.page.evaluate(f"{size}{source!r}; }})") == [220, 160]
        person.leaves()


def _until(what: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


def _ended(path: Path) -> int:
    if not path.is_file():
        return 0
    with sl.Ledger.open(path, model=None, read_only=True) as ledger:
        counts = ledger.counts()
    return counts.total - counts.open


def _count(person: Person) -> int:
    ok, failed, *_ = (int(text) for text in person.page.locator("#counts dd").all_inner_texts()[:2])
    return ok + failed


def test_a_run_is_shown_with_its_offset(person: Person, folder: Path) -> None:
    person.page.fill("#run-row", "8")
    person.page.press("#run-row", "Enter")
    person.waits_for(lambda: "run 8" in person.text("#shape-note"))
    study = sl.load_study(folder)
    with sl.Ledger.open(study.ledger_path, model=None, read_only=True) as ledger:
        record = list(ledger)[7]
    assert record.interface is not None
    assert f"E = {record.inputs['E']:.6g}" in person.text("#run-text")
    found = re.search(r"root mean square ([\d.]+) µm", person.text("#shape-note"))
    assert found is not None
    distances = signed_distances(observations_of(study)[""].points, record.interface)
    assert float(found[1]) == pytest.approx(1e3 * float(np.sqrt(np.mean(distances**2))), rel=4e-3)
    person.page.click("#run-back")
    person.waits_for(lambda: person.page.input_value("#run-row") == "7")
    person.page.click("#run-last")
    person.waits_for(lambda: person.page.input_value("#run-row") == "33")


def test_a_click_on_a_point_shows_its_run(person: Person) -> None:
    point = person.page.locator("#pair-plot .scatterlayer .points path").nth(5)
    box = point.bounding_box()
    person.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    person.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    person.waits_for(lambda: person.page.input_value("#run-row") != "")


def test_sliders_of_the_inputs_move_the_interface(person: Person) -> None:
    person.slides("#sliders input[data-input=E]", 430)
    person.slides("#sliders input[data-input=tilt]", 0.013)
    person.waits_for(lambda: "sliders" in person.text("#shape-note"))
    find = "(e) => e.data.find((t) => t.name === 'sliders').y"
    true = beam({"E": 430.0, "tilt": 0.013, "load": 1e-5}, Path()).interfaces[""]

    def is_there() -> bool:
        drawn = np.array(person.page.locator("#shape-plot").evaluate(find))
        return bool(np.abs(drawn - true.points[:, 1]).max() < 2e-4)

    person.waits_for(is_there)
    assert "error of the surrogate" in person.text("#predict-note")


def test_sliders_of_the_assumptions_move_the_posterior(person: Person, folder: Path) -> None:
    person.slides("#assumptions [data-knob=noise]", float(np.log(2.0)))
    person.waits_for(lambda: person.page.locator("#moments td.asked").count() == 4)
    (answer,) = sl.what_if(sl.load_study(folder), [{"noise": {"sd": 6, "unit": "um"}}]).answers
    assert answer.draws is not None
    shown = person.page.locator("#moments td.asked").first.inner_text()
    mean, sd = (float(part) for part in shown.split("±"))
    assert mean == pytest.approx(answer.draws.mean[0], abs=0.2 * answer.draws.sd[0])
    assert sd == pytest.approx(answer.draws.sd[0], rel=0.12)
    assert "effective draws" in person.text("#asked-note")
    person.page.select_option("[data-knob='prior E']", "normal")
    person.waits_for(lambda: person.page.locator("[data-knob='mean E']").count() == 1)
    person.page.click("#as-stated")
    person.waits_for(lambda: person.page.locator("#moments td.asked").count() == 0)


def test_a_single_posterior_makes_no_history(person: Person) -> None:
    person.waits_for(lambda: "was finished when the page opened" in person.text("#history-note"))
    assert not person.page.is_visible("#history-plot")


def test_the_assumptions_become_a_new_study(person: Person, folder: Path) -> None:
    person.slides("#assumptions [data-knob=noise]", float(np.log(2.0)))
    person.page.fill("#save-name", "wider")
    person.page.click("#save button")
    person.waits_for(lambda: "Saved." in person.text("#save-note"))
    noise = sl.load_study(folder.parent / "wider").noise
    assert isinstance(noise, sl.PointErrors)
    assert noise.sd == pytest.approx(0.006, rel=1e-3)
    person.page.click("#save button")
    person.waits_for(lambda: "expected no such folder yet" in person.text("#save-note"))
    person.faults.clear()  # the browser itself notes the refusal, HTTP 400


def test_the_keyboard_reaches_everything(person: Person) -> None:
    person.page.keyboard.press("Tab")
    assert person.page.evaluate("document.activeElement.className") == "skip"
    for _ in range(80):
        person.page.keyboard.press("Tab")
        if person.page.evaluate("document.activeElement.dataset.knob") == "noise":
            break
    person.page.keyboard.press("ArrowRight")
    person.waits_for(lambda: "effective draws" in person.text("#asked-note"))


@pytest.mark.parametrize(("width", "colours"), SCREENS)
def test_it_fits_and_can_be_read(width: int, colours: str, browser: Any, folder: Path) -> None:
    with serving(sl.load_study(folder)) as server:
        person = Person(browser, server.url, width=width, colours=colours)
        person.sees_posterior()
        person.slides("#sliders input[data-input=E]", 430)
        person.slides("#assumptions [data-knob=noise]", float(np.log(2.0)))
        person.waits_for(lambda: person.page.locator("#moments td.asked").count() == 4)
        assert person.page.evaluate("document.documentElement.scrollWidth") <= width
        found = axe.Axe().run(person.page).response["violations"]
        assert [(one["id"], [node["html"] for node in one["nodes"]][:2]) for one in found] == []
        person.leaves()


def test_runs_that_are_all_done_need_no_new_start(browser: Any, folder: Path) -> None:
    """As while the results are being made: the ledger is closed, and there is no summary yet."""
    (folder / "summary.json").unlink()
    with serving(sl.load_study(folder)) as server:
        person = Person(browser, server.url)
        person.waits_for(lambda: "All runs are done, and their results are being made." in person.text("#driver"))
        person.leaves()


def test_without_the_server_it_says_so(browser: Any, folder: Path) -> None:
    with serving(sl.load_study(folder)) as server:
        person = Person(browser, server.url)
    person.waits_for(lambda: "The server does not answer" in person.text("#status"))
    person.context.close()
