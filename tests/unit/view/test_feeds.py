"""The rows of the page are those of the ledger, however it grew between two looks; and who may see the page."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.interface import Interface
from strandline.report.explore import rounded
from strandline.runs import Ledger, RunRecord, RunRequest
from strandline.runs.ledger.overview import Overview
from strandline.view.server import refusal
from strandline.view.viewed import RunsFeed

LINE = Interface.polyline(np.arange(8.0).reshape(4, 2))
TOKEN = "secret-of-sixteen-letters"


def end(ledger: Ledger, key: str, random: np.random.Generator) -> None:
    state: Any = str(random.choice(["ok", "failed", "timeout", "killed", "invalid"]))
    good = {"": LINE} if state == "ok" else {}
    kind = None if state == "ok" else f"because_{state}"
    ledger.finished(RunRecord(key, {"E": 1.5}, state, good, seconds=random.random(), failure_kind=kind))


def told(feed: RunsFeed, known: dict[int, tuple[object, ...]], version: int) -> int:
    """Take over what the feed says has changed since a version; return its version."""
    new = feed.since(version)
    for row, *rest in zip(*(new[name] for name in ("row", "number", "state", "kind")), strict=True):
        known[row] = tuple(rest)
    return int(new["version"])


@pytest.mark.parametrize("seed", range(2))
def test_what_changed_adds_up_to_the_ledger(seed: int, tmp_path: Path) -> None:
    random, path = np.random.default_rng(seed), tmp_path / "ledger.sqlite"
    feed, known, version = RunsFeed(path, ["E"]), dict[int, tuple[object, ...]](), 0
    assert not feed.update()
    with Ledger.open(path, model="m") as ledger:
        under_way: list[str] = []
        for _ in range(60):
            key = f"k{random.integers(20)}"
            if key not in under_way:
                ledger.started(RunRequest(key, {"E": 1.5}))
                under_way.append(key)
            if random.random() < 0.7:
                end(ledger, under_way.pop(random.integers(len(under_way))), random)
            if random.random() < 0.2:
                with Overview(path) as seen:
                    done = [run.key for run in seen.runs() if run.outcome is not None and run.exclusion is None]
                if done:
                    ledger.exclude(done[0], "looks wrong")
            if random.random() < 0.5:
                feed.update()
                version = told(feed, known, version)
    feed.update()
    told(feed, known, version)
    with Overview(path) as seen:
        runs = {run.key: run for run in seen.runs()}
        first = [runs[key] for key in dict.fromkeys(key for key, _ in seen.changes(0, ()))]
    states = [run.last.state if run.exclusion is None else "excluded" for run in first]
    assert known == {k: (run.last.number, states[k], run.last.kind) for k, run in enumerate(first)}
    assert feed.succeeded == states.count("ok")
    assert not feed.update()
    assert feed.since(feed.version)["row"] == []


def test_numbers_keep_six_digits_and_those_that_json_has_not_are_left_out() -> None:
    values = [None, math.nan, math.inf, 0.0, -1.23456789e-5, 1234567.8]
    assert list(rounded(values)) == [None, None, None, 0.0, -1.23457e-5, 1234570.0]


def test_this_machine_may_and_other_names_and_pages_and_those_without_the_token_may_not() -> None:
    """A page whose domain points here calls it by that domain."""
    for host in ("127.0.0.1:80", "localhost:8123", "LOCALHOST", "[::1]:90", "127.1.2.3"):
        assert refusal(host, None, TOKEN, TOKEN) == refusal(host, f"http://{host}", TOKEN, TOKEN) == ""
    for host in ("example.org", "127.0.0.1.example.org", "192.168.0.3:80", ""):
        assert "127.0.0.1 only" in refusal(host, None, TOKEN, TOKEN)
    for origin in ("http://example.org", "null", "http://localhost:81", "https://localhost:80.example.org"):
        assert "other web pages" in refusal("localhost:80", origin, TOKEN, TOKEN)
    for given in ("", TOKEN + "x", TOKEN.upper()):
        assert "whole address" in refusal("localhost:80", None, given, TOKEN)
