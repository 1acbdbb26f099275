"""How fast the page of a study is in Chromium, with 100, 10 000 and 100 000 runs in the ledger.

    python -m verification.validation.view [--repeats 7] [--publish]

Seconds of a new process, which has not read the ledger yet (worst of three): from the command until it prints the
address, and from the first request until the runs are drawn. Then, of a server that has read it: from the request until
something is painted, until the counts of the runs are there, and until the runs are drawn; from a click on a run until
it is shown; and from a slider's move until the interface or the posterior has followed. Each time, the page is opened
again. Times depend on the machine; the server and the browser share its cores.
"""

import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright
from verification.validation.tables import DOCS, arguments, kept_or_scratch, show, table

import strandline as sl
from strandline.runs import RunRequest
from strandline.testing.studies import beam, write_study
from strandline.view import Server, serving

PAGE = DOCS / "results" / "speed.md"
SIZES = (100, 10_000, 100_000)
FAILING = 0.1
HEADING = "runs | start | first opening | first paint | counts | runs drawn | a run | prediction | posterior"
READY = "() => document.querySelectorAll('#counts div').length > 0"
DRAWN = "() => document.querySelectorAll('#pair-plot .points path').length > 20"
PAINT = "() => performance.getEntriesByType('paint').find((e) => e.name === 'first-contentful-paint').startTime / 1000"
MOVE = "(e, v) => { e.value = v; e.dispatchEvent(new Event('input')); }"


def large_study(folder: Path, runs: int) -> sl.Study:
    """Return an unfinished study of a beam with so many runs in its ledger, a tenth of them failed."""
    study = sl.load_study(write_study(folder, design={"sobol": {"runs": runs}}, noise={"sd": 0.003}))
    random = np.random.default_rng(1)
    with study.runs.ledger() as ledger:
        ledger.plan(study.runs.plan)
        for number, inputs in enumerate([dict(study.truth or {}), *study.runs.design]):
            key, seconds = study.runs.key(inputs), float(random.random())
            ledger.started(RunRequest(key, inputs))
            if number and random.random() < FAILING:
                ledger.finished(sl.RunRecord(key, inputs, "failed", seconds=seconds, failure_kind="diverged"))
            else:
                ledger.finished(sl.RunRecord(key, inputs, "ok", beam(inputs, Path()).interfaces, seconds=seconds))
    return study


def opened(browser: Any, server: Server) -> tuple[Any, list[float]]:
    """Open the page; return it, and the seconds until it is painted, has counts, and has drawn the runs."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    begun = time.perf_counter()
    page.goto(server.url, wait_until="commit")
    page.wait_for_function(READY)
    counts = time.perf_counter() - begun
    page.wait_for_function(DRAWN)
    return page, [page.evaluate(PAINT), counts, time.perf_counter() - begun]


def _new_process(study: sl.Study, browser: Any) -> tuple[float, float]:
    """Return the seconds until `strandline view` prints its address, and until its page has then drawn the runs."""
    command = [sys.executable, "-m", "strandline", "view", str(study.folder), "--no-browser"]
    page, begun = browser.new_page(viewport={"width": 1280, "height": 900}), time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        url, started = server.stdout.readline().split()[-1], time.perf_counter()
        page.goto(url, wait_until="commit")
        page.wait_for_function(DRAWN)
        drawn = time.perf_counter()
        page.close()
        server.kill()
    return started - begun, drawn - started


def answered(page: Any, number: int) -> list[float]:
    """Return the seconds until a run is shown, a prediction has moved, and the posterior has followed."""
    page.fill("#run-row", str(number + 1))
    shown = f"() => document.querySelector('#shape-note').textContent.includes('run {number + 1}')"
    return [
        _until(page, lambda: page.press("#run-row", "Enter"), shown),
        _moved(page, "#sliders input[data-input=E]", 340.0 + number, "#predict-note"),
        _moved(page, "#assumptions [data-knob=noise]", 0.1 + 0.02 * number, "#asked-note"),
    ]


def _moved(page: Any, slider: str, value: float, note: str) -> float:
    page.evaluate("(note) => { document.querySelector(note).textContent = ''; }", note)
    done = f"() => document.querySelector('{note}').textContent.length > 10"
    return _until(page, lambda: page.locator(slider).evaluate(MOVE, value), done)


def _until(page: Any, act: Callable[[], object], done: str) -> float:
    begun = time.perf_counter()
    act()
    page.wait_for_function(done)
    return time.perf_counter() - begun


def _row(runs: int, repeats: int, folder: Path, browser: Any) -> tuple[str, ...]:
    times, study = [], large_study(folder, runs)
    new = np.max([_new_process(study, browser) for _ in range(3)], axis=0)
    with serving(study) as server:
        first, _ = opened(browser, server)
        first.wait_for_selector("#moments td", timeout=120_000)
        for number in range(repeats):
            page, seconds = opened(browser, server)
            page.wait_for_selector("#assumptions [data-knob=noise]")
            times.append([*seconds, *answered(page, number)])
            page.close()
    warm = (f"{np.median(one):.2f} ({np.max(one):.2f})" for one in zip(*times, strict=True))
    return (str(runs), *(f"{seconds:.2f}" for seconds in new), *warm)


def _main() -> None:
    options = arguments(__doc__, repeats=7, publish=False)
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with kept_or_scratch(None) as home, sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium)
        rows = [_row(runs, options.repeats, home / str(runs), browser) for runs in SIZES]
        browser.close()
    found = table("view", "The page, seconds: median (worst)", HEADING, rows)
    show([found], page=PAGE if options.publish else None)


if __name__ == "__main__":
    _main()
