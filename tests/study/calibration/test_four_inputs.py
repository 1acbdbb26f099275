"""Above three inputs two halves of the particles are compared: in the summary, in the terminal and on the page."""

import html
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from strandline.cli.results import show
from strandline.interface import Interface
from strandline.models.protocol import Simulation
from strandline.runs import InProcess
from strandline.studies import load_study, run_study
from strandline.testing.studies import write_study


def chain(inputs: Mapping[str, float], workdir: Path) -> Simulation:
    """A polyline whose heights are the inputs' cumulated sums."""
    heights = np.cumsum([inputs[name] for name in "abcd"])
    return Simulation.of(Interface.polyline(np.stack([np.arange(5.0), np.append(0.0, heights)], axis=1)))


def test_a_study_of_four_inputs_says_whether_the_halves_agree(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_study(
        tmp_path,
        model={"python": {"function": f"{__name__}:chain"}},
        fixed=None,
        inputs={name: {"prior": {"uniform": [0.0, 1.0]}} for name in "abcd"},
        observation={"synthetic": dict.fromkeys("abcd", 0.5)},
        noise={"sd": 0.2},
        design={"sobol": {"runs": 32}},
        sampler={"smc": {"particles": 1000, "rejuvenation_steps": 10}},
        surrogate={"field": {}},
        draft=True,
    )
    outcome = run_study(load_study(folder), executor=InProcess())
    show(outcome.summary, outcome.report)
    summary, printed = json.loads((folder / "summary.json").read_text("utf-8")), capsys.readouterr().out
    check, page = summary["sampler_check"], html.unescape(outcome.report.read_text("utf-8"))
    assert check["agree"]
    assert set(check["mean_difference_sd"]) == set(check["sd_ratio"]) == set("abcd")
    assert np.exp(summary["log_evidence"]) == pytest.approx(np.mean(np.exp(check["log_evidence"])), rel=1e-6)
    assert check["verdict"] in printed
    assert check["verdict"] in page
    assert "steps of the first half" in page
    assert not any("independent halves" in warning for warning in summary["warnings"])
