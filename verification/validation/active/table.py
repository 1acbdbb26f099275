"""Tables of the numbers of runs needed, and of where whole calibrations stopped."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any

from verification.validation.tables import Table, table

GOOD = {
    "S3": lambda p: p["total_variation"] < 0.05,
    "S5": lambda p: p["mean_error"] < 0.1 and p["sd_error"] < 0.05,
    "S6": lambda p: p.get("effective", 0.0) >= 0.8 and p["k_hat"] < 0.5 and p["shift"] < 0.1,
}
Rows = Sequence[Mapping[str, Any]]


def needed(course: Mapping[str, Any]) -> int | None:
    """Return the number of runs from which on the posterior is right; None if it is still wrong at the end."""
    good, found = GOOD[course["study"]], None
    for point in reversed(course["points"]):
        if not good(point):
            break
        found = point["runs"]
    return found


def runs_table(courses: Rows) -> Table:
    """Return the number of runs until the posterior is right, median and worst over the seeds."""
    rows = []
    keys = ("study", "quadrature", "criterion", "share", "sensitivities")
    for (study, rule, criterion, share, gradients), some in _grouped(courses, keys):
        runs = [needed(course) for course in some]
        reached = sorted(n for n in runs if n is not None)
        worst = "not all" if len(reached) < len(runs) else str(reached[-1])
        middle = f"{median(reached):g}" if 2 * len(reached) > len(runs) else "not reached"
        spent = median(point["seconds"] for course in some for point in course["points"])
        told = criterion.replace("_", " "), f"{share:.0%}", "yes" if gradients else "no"
        rows.append((study, rule, *told, len(runs), middle, worst, spent))
    heading = (
        "study | quadrature | criterion | failing at random | sensitivities | seeds {d} | runs, median | runs, worst "
        "| s a batch {.1f}"
    )
    return table("active-runs", "Runs until the posterior is right", heading, rows)


def stopping_table(stopped: Rows) -> Table:
    """Return where calibrations stopped by themselves, and their errors there."""
    rows = []
    for (study, rule, gradients), some in _grouped(stopped, ("study", "quadrature", "sensitivities")):
        ended = [one for one in some if one["converged"]]
        figures = [
            f"{median(values):.3g} ({max(values):.3g})"
            for values in ([one[key] for one in ended] for key in ("runs", "chosen", "mean_error", "sd_error"))
            if values
        ] or [""] * 4
        rows.append((study, rule, "yes" if gradients else "no", len(some), len(ended), *figures))
    heading = (
        "study | quadrature | sensitivities | seeds {d} | converged {d} | runs | runs before the last check "
        "| error of a mean, sd | relative error of an sd"
    )
    title = "Where calibrations stop of themselves: medians, the worst in brackets"
    return table("active-stopping", title, heading, rows)


def _grouped(rows: Rows, keys: Sequence[str]) -> Iterable[tuple[tuple[Any, ...], list[Mapping[str, Any]]]]:
    groups: dict[tuple[Any, ...], list[Mapping[str, Any]]] = defaultdict(list)
    for row in rows:
        groups[tuple(row[key] for key in keys)].append(row)
    return sorted(groups.items(), key=lambda item: str(item[0]))
