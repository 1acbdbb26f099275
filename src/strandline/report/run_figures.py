"""Figures of the runs themselves: the best ones against the observation, and where runs failed."""

from collections import Counter
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from strandline.calibration import Calibration
from strandline.posterior import observed_offsets
from strandline.report import plots
from strandline.report.captioned import Captioned, whole

__all__ = ["failed_runs", "offsets_of_runs"]

SHOWN = 5
"""Number of best runs whose offsets are drawn, including the one at zero."""
TWO = 2


def offsets_of_runs(calibration: Calibration) -> Iterator[Captioned]:
    """Yield the normal offsets of the observation and of the best runs from the best one, by condition.

    Nothing is drawn for a surrogate of the field: it predicts interfaces, and its own figure shows the posterior's.
    """
    if calibration.field is not None:
        return
    problem = calibration.problem
    good = [record for record in calibration.records if record.ok]
    values = next(iter(calibration.log_likelihoods.values()))
    ranked = np.argsort(-values, kind="stable")[:SHOWN]
    for seen in problem.observations:
        interfaces = [good[i].interfaces[seen.condition] for i in ranked]
        if any(interface.dim != TWO for interface in (seen.interface, *interfaces)):
            continue
        best, *others = interfaces
        runs = {
            f"{_ordinal(k)} best run, log-likelihood {_number(values[ranked[k - 1]])}": observed_offsets(
                interface, best
            )
            for k, interface in enumerate(others, start=2)
        }
        centre = "best run"
        axes = plots.plot_run_offsets(observed_offsets(seen.interface, best), runs, centre=centre)
        of = f" of {seen.condition}" if seen.condition else ""
        caption = (
            f"Normal offsets{of} from the best run, whose log-likelihood is {_number(values[ranked[0]])}: of the "
            "observed interface and of the next best runs. They are runs of the design, not draws of the posterior."
        )
        name = f"offsets{'_' + seen.condition if seen.condition else ''}"
        yield Captioned(name, "data", caption, whole(axes.figure))


def failed_runs(calibration: Calibration) -> Iterator[Captioned]:
    """Yield a picture of the failed runs if there are any and more than two inputs; for two, the maps show them."""
    space = calibration.problem.space
    failed = [record for record in calibration.records if not record.ok]
    if space.dim <= TWO or not failed:
        return

    def inputs(records: list[dict[str, float]]) -> Float[np.ndarray, "run dim"]:
        return np.array([[row[name] for name in space.names] for row in records], float).reshape(-1, space.dim)

    kinds = [record.failure_kind or record.state for record in failed]
    by_kind = {
        kind: inputs([dict(record.inputs) for record, its in zip(failed, kinds, strict=True) if its == kind])
        for kind, _ in Counter(kinds).most_common()
    }
    ok = inputs([dict(record.inputs) for record in calibration.records if record.ok])
    axes = plots.plot_failed_runs(space, ok, by_kind)
    caption = "Inputs of all runs, one line each: grey if the run succeeded, coloured by kind if it failed."
    yield Captioned("failed_runs", "runs", caption, whole(axes.figure))


def _number(value: float) -> str:
    """Return a number with four significant digits and a proper minus."""
    return f"{value:.4g}".replace("-", "−")


def _ordinal(number: int) -> str:
    return {2: "second", 3: "third", 4: "fourth", 5: "fifth"}.get(number, f"{number}th")
