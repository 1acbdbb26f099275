"""Doors that third parties use by ``module:name``, in study files and in Python."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.discrepancy import DISCREPANCIES
from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import Interface
from strandline.models.protocol import ForwardModel, Simulation
from strandline.registry import lookup
from strandline.runs import InProcess, RunRecord, RunRequest
from strandline.studies import load_study, run_study
from strandline.testing.models import Cantilever
from strandline.testing.studies import write_study


@dataclass(frozen=True)
class Hausdorff:
    """Squared largest distance of a simulated node from the nearest observed one."""

    factor: float = 1.0

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        apart = np.linalg.norm(simulated.points[:, None] - observed.points, axis=2)
        return float(self.factor * apart.min(axis=1).max() ** 2)


@dataclass(frozen=True)
class Triangle:
    """Density falling from `low` to `high` in a straight line."""

    low: float
    high: float

    @property
    def support(self) -> tuple[float, float]:
        return self.low, self.high

    def log_density(self, x: Any) -> Any:
        import jax.numpy as jnp

        inside = (x >= self.low) & (x <= self.high)
        density = 2.0 * (self.high - x) / (self.high - self.low) ** 2
        array = jnp if not isinstance(x, np.ndarray | float) else np
        return array.where(inside, array.log(array.maximum(density, 1e-300)), -math.inf)

    def cdf(self, x: Any) -> Any:
        share = np.clip((np.asarray(x) - self.low) / (self.high - self.low), 0.0, 1.0)
        return 1.0 - (1.0 - share) ** 2

    def quantile(self, p: Any) -> Any:
        return self.low + (self.high - self.low) * (1.0 - np.sqrt(1.0 - np.asarray(p)))


@dataclass(frozen=True)
class Sheared:
    """The cantilever, its tip moved by `shear` as well."""

    shear: float = 0.0
    fingerprint = "test:sheared"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        found = Cantilever()(dict(inputs) | {"load": 1e-5}, workdir)
        points = found.interface.points + np.array([self.shear, 0.0]) * found.interface.points[:, :1]
        return Simulation.of(Interface.polyline(points))


@dataclass(frozen=True)
class Counting:
    """Runs in this process, and notes how many."""

    note: str

    def __call__(self, model: ForwardModel, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        for number, record in enumerate(InProcess()(model, requests), 1):
            Path(self.note).write_text(str(number))
            yield record


HERE = __name__
SMALL = {"design": {"sobol": {"runs": 12}}, "sampler": {"smc": {"particles": 1000, "rejuvenation_steps": 2}}}


def test_a_study_of_entries_that_are_all_somebody_elses(tmp_path: Path) -> None:
    folder = write_study(
        tmp_path / "own",
        model={f"{HERE}:Sheared": {"shear": 0.01}},
        fixed={},
        inputs={"E": {"prior": {f"{HERE}:Triangle": [300.0, 800.0]}}},
        observation={"synthetic": {"E": 450.0}},
        discrepancy={f"{HERE}:Hausdorff": {"factor": 2.0}},
        executor={f"{HERE}:Counting": {"note": str(tmp_path / "note")}},
        **SMALL,
        draft=True,
        report="none",
    )
    study = load_study(folder)
    assert study.model == Sheared(0.01)
    assert study.space["E"].prior == Triangle(300.0, 800.0)
    assert next(iter(study.discrepancies.values())) == Hausdorff(2.0)
    found = run_study(study)
    assert (tmp_path / "note").read_text() == "12"
    assert 300.0 < found.calibration.posterior.mean[0] < 800.0


REFUSED = {
    "curents": "Did you mean currents",
    "no_such_module:Measure": "ModuleNotFoundError",
    "math:no_such_name": "a name defined in math",
    ":Measure": "module:name, e.g.",
}


def test_what_is_not_there_is_refused(tmp_path: Path) -> None:
    for name, words in REFUSED.items():
        with pytest.raises(InvalidInput, match=words):
            lookup(DISCREPANCIES, name, "discrepancy")
    with pytest.raises(InvalidStudy, match="Did you mean currents"):
        load_study(write_study(tmp_path / "study", discrepancy={"curents": {}}))


def test_a_mistake_in_a_module_is_told_with_its_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "with_a_mistake.py").write_text("x = 1\ny = math.pi * x\n")
    (tmp_path / "without_its_own.py").write_text("import no_such_module_of_ours\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InvalidInput, match=r"NameError: name 'math' is not defined, in with_a_mistake.py, line 2"):
        lookup(DISCREPANCIES, "with_a_mistake:Measure", "discrepancy")
    with pytest.raises(InvalidInput, match=r"no_such_module_of_ours.*in without_its_own.py, line 1"):
        lookup(DISCREPANCIES, "without_its_own:Measure", "discrepancy")


def test_what_is_no_dataclass_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidStudy, match="a dataclass that is a discrepancy"):
        load_study(write_study(tmp_path / "study", discrepancy={"math:sqrt": {}}))
