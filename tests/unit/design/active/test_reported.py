"""The line that is printed after each batch of an active design."""

from typing import Any

import numpy as np

from strandline.design.active.active_design import ActiveDesign, Batch, Kind, Step
from strandline.design.active.reported import BatchReport, report_batch
from strandline.design.active.settings import Active
from strandline.design.active.state import Moved
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform

SPACE = ParameterSpace((Parameter("E", Uniform(0.0, 800.0), "Pa"), Parameter("nu", Uniform(-1.0, 0.5), symbol="ν")))


def design(
    kinds: list[Kind], steps: int, *, moved: float | None = 0.049, effective: float = 0.99, converged: bool = False
) -> ActiveDesign:
    def nothing(*arguments: Any) -> Any:
        raise AssertionError("a report learns nothing")

    made = ActiveDesign(Active(runs=50), SPACE, batch=4, learn=nothing, log_likelihood=nothing, seed=1)
    made.converged = converged
    made.reasons = () if converged or steps < len(kinds) else ("all runs are made",)
    made.batches = [Batch(np.zeros((4, 2)), kind) for kind in kinds]
    change = None if moved is None else Moved(moved, 0.01, effective)
    mean, sd = np.array([396.24, 0.2741]), np.array([31.2, 0.114])
    made.steps = [Step(8, 8, "posterior", mean, sd, 1e-3, change, None, None)] * steps
    return made


def test_the_line() -> None:
    for given, line in [
        (design(["initial", "posterior", "posterior", "check"], 3), "moved 0.05 sd; next: check"),
        (design(["initial", "posterior"], 1, moved=None), "; next: a batch"),
        (design(["initial", "check", "trial"], 2), "moved 0.05 sd; next: the correction is tried again"),
        (design(["initial", "posterior"], 1, moved=9.0, effective=0.01), "moved far; next: a batch"),
        (design(["initial", "check"], 2, converged=True), "moved 0.05 sd; next: done, converged"),
        (design(["initial", "check"], 2), "moved 0.05 sd; next: stop, not converged"),
    ]:
        report = report_batch(given, SPACE)
        assert report.line.startswith(f"batch {len(given.steps)}: E 396 ± 31, ν 0.27 ± 0.11")
        assert report.line.endswith(line)


def test_a_dropped_cheaper_model_is_told_and_many_inputs_are_cut_short() -> None:
    report = BatchReport(2, ("a 1 ± 1",), 0.1, "batch", "why", "it errs")
    assert report.line.endswith("; check: why; the cheaper model is no longer used: it errs; next: a batch")
    many = BatchReport(2, ("a 1 ± 1",) * 5, None, "batch")
    assert many.line == "batch 2: a 1 ± 1, a 1 ± 1, a 1 ± 1, …; next: a batch"
