"""Tables of how many runs it took."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

__all__ = ["needed", "tables"]

GOOD = {
    "S3": lambda p: p["total_variation"] < 0.05,
    "S5": lambda p: p["mean_error"] < 0.1 and p["sd_error"] < 0.05,
    "S6": lambda p: p.get("effective", 0.0) >= 0.8 and p["k_hat"] < 0.5 and p["shift"] < 0.1,
}


def needed(course: Mapping[str, Any]) -> int | None:
    """Return the number of runs from which on the posterior is right; None if it is not at the end."""
    good, found = GOOD[course["study"]], None
    for point in reversed(course["points"]):
        if not good(point):
            break
        found = point["runs"]
    return found


def tables(courses: Sequence[Mapping[str, Any]]) -> str:
    """Return a table in Markdown: medians and worst over the seeds."""
    groups: dict[tuple[Any, ...], list[Mapping[str, Any]]] = defaultdict(list)
    for course in courses:
        key = (course["part"], course["study"], course["quadrature"], course["sensitivities"], course["criterion"])
        groups[(*key, course.get("share", 0.0))].append(course)
    lines = [
        "| study | quadrature | sensitivities | criterion | failing at random | seeds | runs, median | runs, worst |"
        " seconds a batch |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for (_, study, rule, gradients, criterion, share), some in sorted(groups.items(), key=str):
        runs = [needed(course) for course in some]
        reached = [n for n in runs if n is not None]
        worst = "not all" if len(reached) < len(runs) else str(max(reached))
        middle = f"{median(reached):g}" if 2 * len(reached) > len(runs) else "not reached"
        spent = median(point["seconds"] for course in some for point in course["points"])
        lines.append(
            f"| {study} | {rule} | {'yes' if gradients else 'no'} | {criterion.replace('_', ' ')} | {share:.0%} | "
            f"{len(runs)} | {middle} | {worst} | {spent:.1f} |"
        )
    return "\n".join(lines)
