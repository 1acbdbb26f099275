"""A person's whole way in a real browser: a campaign, the sliders, another posterior, a new study.

What the page shows is compared with what the library computes.
"""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.doors.reader import SCREENS, Reader, moments
from tests.doors.view.conftest import SMALL

import strandline as sl
from strandline.runs import RunRequest
from strandline.testing.studies import beam, write_study
from strandline.view import Server, serving

SLOW = """
import time
from strandline.foundations import ForwardModelError
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
        self.page.wait_for_selector("#moments td", timeout=60_000)

    def slides(self, selector: str, value: float) -> None:
        """Move a slider, and let go."""
        move = "(e, v) => { e.value = v; e.dispatchEvent(new Event('input')); e.dispatchEvent(new Event('change')); }"
        self.page.locator(selector).evaluate(move, value)

    def sees_asked(self, number: int) -> None:
        self.waits_for(lambda: self.page.locator("#moments td.asked").count() == number)

    def asked(self) -> tuple[float, float]:
        """Return mean and standard deviation of the first input under the assumptions that were asked for."""
        return moments(self.page.locator("#moments td.asked").first.inner_text())


@pytest.fixture
def person(browser: Any, folder: Path) -> Iterator[Person]:
    with serving(sl.load_study(folder)) as server:
        found = Person(browser, server)
        found.sees_posterior()
        yield found
        found.leaves()


def test_a_campaign_while_it_runs(browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The posterior takes shape, a failure is named; the page outlives the driver."""
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
        assert person.page.is_visible("#history-plot")
        person.leaves()


def test_a_study_whose_model_has_changed_says_so(browser: Any, tmp_path: Path) -> None:
    folder = write_study(tmp_path / "beam", **SMALL | {"observation": {"file": "seen.csv", "unit": "mm"}})
    (folder / "seen.csv").write_text("0,0\n0.5,0.01\n1,0.03\n")
    with sl.Ledger.open(folder / "ledger.sqlite", model="an earlier one") as ledger:
        ledger.started(RunRequest("key", {"E": 400.0}))
    with serving(sl.load_study(folder)) as server:
        person = Reader(browser, server.url, ready="#problem:not([hidden])")
        assert "keeps the runs of another model" in person.text("#problem")
        assert person.text("#status") == "Not shown, because of this:"
        person.context.close()


def test_sliders_of_the_inputs_move_the_interface(person: Person) -> None:
    person.slides("#sliders input[data-input=E]", 430)
    person.slides("#sliders input[data-input=tilt]", 0.013)
    person.waits_for(lambda: "sliders" in person.text("#shape-note"))
    true = beam({"E": 430.0, "tilt": 0.013, "load": 1e-5}, Path()).interfaces[""]
    person.waits_for(lambda: np.abs(person.drawn("sliders")[1] - true.points[:, 1]).max() < 2e-4)
    assert "error of the surrogate" in person.text("#predict-note")


def test_sliders_of_the_assumptions_move_the_posterior_by_keys_too(person: Person, folder: Path) -> None:
    """A single posterior makes no history."""
    person.waits_for(lambda: "was finished when the page opened" in person.text("#history-note"))
    assert not person.page.is_visible("#history-plot")
    person.page.press(NOISE, "ArrowRight")
    person.waits_for(lambda: "effective draws" in person.text("#asked-note"))
    person.slides(NOISE, float(np.log(2.0)))
    person.sees_asked(4)
    (answer,) = sl.what_if(sl.load_study(folder), [{"noise": {"sd": 6, "unit": "um"}}]).found
    person.waits_for(lambda: abs(person.asked()[1] / answer.draws.sd[0] - 1) < 0.12)
    assert person.asked()[0] == pytest.approx(answer.draws.mean[0], abs=0.2 * answer.draws.sd[0])
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
