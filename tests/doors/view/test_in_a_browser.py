"""A person's whole way in a real browser: a campaign, one run, the sliders, another posterior, a new study.

What the page shows is compared with what the library computes.
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
from tests.doors.reader import SCREENS, Reader, moments
from tests.doors.view.conftest import SMALL
from tests.unit.studies.hump import height, written

import strandline as sl
from strandline.discrepancy.normal_offset import signed_distances
from strandline.studies.first_run import observations_of
from strandline.testing.studies import beam, write_study
from strandline.view import Server, serving

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
NOISE = "#assumptions [data-knob=noise]"


class Person(Reader):
    """Somebody who looks at the page of a study."""

    def __init__(self, browser: Any, server: Server, **options: Any) -> None:
        super().__init__(browser, server.url, ready="#counts div", **options)

    def sees_posterior(self) -> None:
        self.page.wait_for_selector("#moments td", timeout=30_000)

    def slides(self, selector: str, value: float) -> None:
        """Move a slider, and let go."""
        move = "(e, v) => { e.value = v; e.dispatchEvent(new Event('input')); e.dispatchEvent(new Event('change')); }"
        self.page.locator(selector).evaluate(move, value)

    def sees_asked(self, number: int) -> None:
        self.waits_for(lambda: self.page.locator("#moments td.asked").count() == number)


@pytest.fixture
def person(browser: Any, folder: Path) -> Iterator[Person]:
    with serving(sl.load_study(folder)) as server:
        found = Person(browser, server)
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
    run = [sys.executable, "-m", "strandline", "run", str(folder), "--quiet"]
    with serving(sl.load_study(folder)) as server:
        person = Person(browser, server)
        assert person.text("#status").startswith("0 of 40 runs done")
        assert "No forward run has been started yet." in person.text("#driver")
        driver = subprocess.Popen(run)
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
        subprocess.run(run, check=True, timeout=300)
        person.waits_for(lambda: "finished" in person.text("#status"))
        person.waits_for(lambda: "The study's own result" in person.text("#posterior-source"))
        person.page.click("#failures summary")
        assert "too stiff" in person.text("#failures")
        assert len(server.viewed.newest.shown.history) >= 3
        assert person.page.is_visible("#history-plot")
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


def test_the_edge_lies_on_the_picture_behind_it(browser: Any, tmp_path: Path) -> None:
    with serving(sl.load_study(written(tmp_path / "hump"))) as server:
        person = Person(browser, server)
        person.page.wait_for_selector("#shape-plot .layer-below image, #shape-plot image")
        x, y = person.drawn("observed")
        assert np.abs(y - height(x)).max() < 1.5
        assert np.abs(y + 5 - height(x)).max() > 1.5  # planted: five pixels lower
        load = """(e) => new Promise((done) => {
          const i = new Image(); i.onload = () => done([i.width, i.height]); i.src = e.layout.images[0].source; })"""
        assert person.page.locator("#shape-plot").evaluate(load) == [220, 160]
        person.leaves()


def test_a_run_is_shown_with_its_offset(person: Person, folder: Path) -> None:
    person.clicks_on_point(5)
    person.page.fill("#run-row", "8")
    person.page.press("#run-row", "Enter")
    person.waits_for(lambda: "run 8" in person.text("#shape-note"))
    study = sl.load_study(folder)
    with sl.Ledger.open(study.ledger_path, model=None, read_only=True) as ledger:
        record = list(ledger)[7]
    assert f"E = {record.inputs['E']:.6g}" in person.text("#run-text")
    found = re.search(r"root mean square ([\d.]+) µm", person.text("#shape-note"))
    assert found is not None
    distances = signed_distances(observations_of(study)[""].points, record.interface)
    assert float(found[1]) == pytest.approx(1e3 * float(np.sqrt(np.mean(distances**2))), rel=4e-3)
    person.goes_to("Enter", "#run-back", "7")
    person.goes_to("Enter", "#run-last", "33")


def test_sliders_of_the_inputs_move_the_interface(person: Person) -> None:
    person.slides("#sliders input[data-input=E]", 430)
    person.slides("#sliders input[data-input=tilt]", 0.013)
    person.waits_for(lambda: "sliders" in person.text("#shape-note"))
    true = beam({"E": 430.0, "tilt": 0.013, "load": 1e-5}, Path()).interfaces[""]
    person.waits_for(lambda: np.abs(person.drawn("sliders")[1] - true.points[:, 1]).max() < 2e-4)
    assert "error of the surrogate" in person.text("#predict-note")


def test_sliders_of_the_assumptions_move_the_posterior(person: Person, folder: Path) -> None:
    """A single posterior makes no history."""
    person.waits_for(lambda: "was finished when the page opened" in person.text("#history-note"))
    assert not person.page.is_visible("#history-plot")
    person.slides(NOISE, float(np.log(2.0)))
    person.sees_asked(4)
    (answer,) = sl.what_if(sl.load_study(folder), [{"noise": {"sd": 6, "unit": "um"}}]).answers
    mean, sd = moments(person.page.locator("#moments td.asked").first.inner_text())
    assert mean == pytest.approx(answer.draws.mean[0], abs=0.2 * answer.draws.sd[0])
    assert sd == pytest.approx(answer.draws.sd[0], rel=0.12)
    assert "effective draws" in person.text("#asked-note")
    person.page.select_option("[data-knob='prior E']", "normal")
    person.waits_for(lambda: person.page.locator("[data-knob='mean E']").count() == 1)
    person.page.click("#as-stated")
    person.sees_asked(0)


def test_the_assumptions_become_a_new_study(person: Person, folder: Path) -> None:
    person.slides(NOISE, float(np.log(2.0)))
    person.page.fill("#save-name", "wider")
    person.page.click("#save button")
    person.waits_for(lambda: "Saved." in person.text("#save-note"))
    assert sl.load_study(folder.parent / "wider").noise.sd == pytest.approx(0.006, rel=1e-3)
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
def test_it_can_be_read_and_says_when_the_server_is_gone(width: int, colours: str, browser: Any, folder: Path) -> None:
    """Without a summary, as while the results are being made, runs that are all done need no new start."""
    with serving(sl.load_study(folder)) as server:
        person = Person(browser, server, width=width, colours=colours)
        person.sees_posterior()
        person.slides("#sliders input[data-input=E]", 430)
        person.slides(NOISE, float(np.log(2.0)))
        person.sees_asked(4)
        person.sees_no_fault()
        (folder / "summary.json").unlink()
        person.waits_for(lambda: "All runs are done, and their results are being made." in person.text("#driver"))
        assert person.faults == []
    person.waits_for(lambda: "The server does not answer" in person.text("#status"))
    person.context.close()
