"""Doors that third parties use by ``module:name``, in study files and in Python."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from strandline.discrepancy import DISCREPANCIES, TrackedPoints
from strandline.foundations import InvalidInput, InvalidStudy, lookup
from strandline.interface import Interface
from strandline.models.protocol import ForwardModel, Simulation
from strandline.parameters import Uniform
from strandline.runs import InProcess, RunRecord, RunRequest
from strandline.studies import load_study, run_study
from strandline.testing.models import Cantilever
from strandline.testing.studies import write_study


@dataclass(frozen=True)
class Doubled(TrackedPoints):
    """A measure with an option."""

    factor: float = 1.0

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        return self.factor * super().__call__(simulated, observed)


@dataclass(frozen=True)
class Mine(Uniform):
    """A prior of somebody else."""


@dataclass(frozen=True)
class Loaded:
    """The cantilever under a load that is an option."""

    load: float = 0.0
    fingerprint = "test:loaded"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        return Cantilever()({**inputs, "load": self.load}, workdir)


@dataclass(frozen=True)
class Counting:
    """Runs in this process, and notes how many."""

    note: str

    def __call__(self, model: ForwardModel, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        for number, record in enumerate(InProcess()(model, requests), 1):
            Path(self.note).write_text(str(number))
            yield record


def test_a_study_of_entries_that_are_all_somebody_elses(tmp_path: Path) -> None:
    own = {
        "model": {f"{__name__}:Loaded": {"load": 1e-5}},
        "inputs": {"E": {"prior": {f"{__name__}:Mine": [300.0, 800.0]}}},
        "discrepancy": {f"{__name__}:Doubled": {"factor": 2.0}},
        "executor": {f"{__name__}:Counting": {"note": str(tmp_path / "note")}},
    }
    small = {"design": {"sobol": {"runs": 12}}, "sampler": {"smc": {"particles": 1000, "rejuvenation_steps": 2}}}
    others = {"fixed": {}, "observation": {"synthetic": {"E": 450.0}}, "draft": True, "report": "none"}
    study = load_study(write_study(tmp_path / "own", **own, **small, **others))
    assert (study.model, study.space["E"].prior) == (Loaded(1e-5), Mine(300.0, 800.0))
    assert study.measure == Doubled(factor=2.0)
    found = run_study(study)
    assert (tmp_path / "note").read_text() == "12"
    assert 300.0 < found.calibration.posterior.mean[0] < 800.0


def test_what_is_not_there_or_no_dataclass_is_refused(tmp_path: Path) -> None:
    wrong = {"no_such_module:Measure": "ModuleNotFoundError", "math:no_such_name": "a name defined in math"}
    for name, words in {**wrong, ":Measure": "module:name, e.g."}.items():
        with pytest.raises(InvalidInput, match=words):
            lookup(DISCREPANCIES, name, "discrepancy")
    for name, words in {"curents": "Did you mean currents", "math:sqrt": "a dataclass that is a discrepancy"}.items():
        with pytest.raises(InvalidStudy, match=words):
            load_study(write_study(tmp_path / "study", discrepancy={name: {}}))


def test_a_mistake_in_a_module_is_told_with_its_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "with_a_mistake.py").write_text("x = 1\ny = math.pi * x\n")
    (tmp_path / "without_its_own.py").write_text("import no_such_module_of_ours\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InvalidInput, match=r"NameError: name 'math' is not defined, in with_a_mistake.py, line 2"):
        lookup(DISCREPANCIES, "with_a_mistake:Measure", "discrepancy")
    with pytest.raises(InvalidInput, match=r"no_such_module_of_ours.*in without_its_own.py, line 1"):
        lookup(DISCREPANCIES, "without_its_own:Measure", "discrepancy")
