"""`strandline check`: one run, and nothing written."""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import pytest
from tests.unit.cli.command_line import Shown, contents, printed, refused

from strandline.cli.check import _prepared
from strandline.interface import Interface
from strandline.runs import Ledger
from strandline.studies import load_study
from strandline.testing.studies import BEAM_STUDY, undeclared_beam, write_study


@dataclass(frozen=True)
class Flat:
    """A measure that is the same for all interfaces, so that no noise of the points has a rule."""

    unit: ClassVar[str] = "mm²"

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        return 1.0


def test_it_makes_one_run_and_writes_nothing(tmp_path: Path, capsys: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Any] = []

    def noted(inputs: Any, workdir: Path) -> Any:
        calls.append(inputs)
        return undeclared_beam(inputs, workdir)

    monkeypatch.setattr("strandline.testing.studies.undeclared_beam", noted)
    folder = write_study(tmp_path / "study")
    shown = printed(capsys, "check", str(folder))
    assert calls == [{"load": 1e-5, "E": 430.0, "tilt": 0.02}]
    assert list(contents(folder)) == ["study.yaml"]
    assert "beam: study.yaml is sound" in shown
    assert "64 forward runs planned, 0 of them known already" in shown
    assert "E [Pa]: Uniform(low=300.0, high=560.0)" in shown
    assert "add --widths to predict the widths of the posterior: 2 more runs" in shown


def test_a_cut_prior_and_known_runs_are_told(tmp_path: Path, capsys: Shown) -> None:
    E = {"prior": {"lognormal": [6.0, 0.2]}, "box": [300, 560], "unit": "Pa"}
    folder = write_study(tmp_path / "study", inputs={**BEAM_STUDY["inputs"], "E": E})
    Ledger.open(folder / "ledger.sqlite", model="test:beam-1").close()
    shown = printed(capsys, "check", str(folder))
    assert "11.98% of its mass cut off by the box" in shown
    assert "0 of them known already" in shown


def test_json_says_what_the_lines_say(tmp_path: Path, capsys: Shown) -> None:
    folder = write_study(tmp_path / "study")
    found = json.loads(printed(capsys, "check", str(folder), "--json", "--widths"))
    assert found["run"]["inputs"]["E"] == pytest.approx(430.0)
    assert found["inputs"]["tilt"] == {"unit": "1", "box": [0.0, 0.04], "nuisance": False}
    assert (found["planned"], found["known"]) == (64, 0)
    assert any("2 more runs" in line for line in found["lines"])
    shown = printed(capsys, "check", str(folder), "--widths").splitlines()
    plain = [re.sub(r"in [\d.]+ s", "", line) for line in found["lines"]]
    assert [re.sub(r"in [\d.]+ s", "", line.removeprefix("  ")) for line in shown[1 : 1 + len(plain)]] == plain


def test_a_measure_without_a_rule_for_the_noise_is_refused(tmp_path: Path, capsys: Shown) -> None:
    measure, noise = {f"{__name__}:Flat": {}}, {"sd": 3, "unit": "um"}
    line = refused(capsys, "check", str(write_study(tmp_path, discrepancy=measure, noise=noise)))
    assert "noise of Flat" in line
    assert "a noise variance for such errors" in line


def test_it_says_how_many_runs_start_from_what_is_prepared(tmp_path: Path) -> None:
    class Prepared:
        preparation = "anchors"
        limit = 500.0

        def __call__(self, inputs: Any, workdir: Path) -> Any: ...

        def prepare_runs(self) -> None: ...

        def is_prepared(self, inputs: Any) -> bool:
            return bool(inputs["E"] < self.limit)

    study, model = load_study(write_study(tmp_path)), Prepared()
    for limit, told in ((500.0, "anchors: 50"), (430.0, "anchors: 32"), (420.0, "warning: anchors: 30")):
        model.limit = limit
        (line,) = _prepared(replace(study, model=model))
        assert line == f"{told} of the 64 planned runs start from them"
    assert list(_prepared(study)) == []
