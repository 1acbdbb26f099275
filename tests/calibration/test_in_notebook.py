"""Progress below the cell of a notebook."""

import re

import numpy as np

import strandline as sl
from strandline.calibration.in_notebook import cell_observer, observer_or_default


def line(inputs: dict[str, float], workdir: object) -> sl.Interface:
    return sl.Interface.polyline(np.stack([np.linspace(0.0, 1.0, 5), inputs["a"] * np.linspace(0.0, 1.0, 5)], axis=1))


def text(shown: str) -> str:
    return re.sub(r"<[^>]+>", "\n", shown)


def test_the_stages_and_how_far_each_has_got() -> None:
    space = sl.ParameterSpace((sl.Parameter("a", sl.Uniform(0.0, 1.0)),))
    seen = sl.Observation(line({"a": 0.4}, None), 0.01)
    problem = sl.Problem(line, space, {}, (seen,), {"points": sl.TrackedPoints()})
    shown: list[str] = []
    settings = sl.Settings(runs=12, particles=200, smc=sl.SMCSettings(rejuvenation_steps=2))
    sl.calibrate(problem, settings, observer=cell_observer(shown.append))
    last = text(shown[-1])
    assert "forward runs 12/12: 12 ok, 0 failed" in last
    assert re.search(r"sampling tempering exponent 1\.0000, ESS \d+, accepted \d+%", last)
    assert len(shown) > 14


def test_what_it_shows_is_text() -> None:
    shown: list[str] = []
    observer = cell_observer(shown.append)
    observer.note("before any stage")
    assert shown == []
    observer.stage("forward")
    observer.note("<b>bold</b>")
    assert "&lt;b&gt;bold&lt;/b&gt;" in shown[-1]


def test_nothing_outside_a_notebook_and_ones_own_is_kept() -> None:
    own = sl.Observer()
    assert observer_or_default(own) is own
    silent = observer_or_default(None)
    silent.stage("forward")
    silent.note("nothing happens")
