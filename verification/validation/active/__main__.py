"""Active designs on a surrogate of the field, compared with the true model, for several seeds and in two processes.

    python -m verification.validation.active PART … [--seeds 5] [--criterion NAME] [--quadrature refined|centre]
        [--workers 2] [--publish]

Parts: s3, s5, s6 (runs until the posterior is right), failing (runs that fail at random), stopping (where whole
calibrations stop). Results are appended to ../output/active.jsonl; the part ``table`` prints tables of all of them, and
with ``--publish`` puts them into docs/results/designs.md and their numbers into active-designs.json next to it.
All parts take two hours on two cores. A quadrature restricts s3 and s6 to this one.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context
from statistics import median
from typing import Any

from verification.validation.active.designs import case, right, s3, s5, s6, stopped, truth_of
from verification.validation.tables import DOCS, OUTPUT, Table, arguments, show, table

from strandline.foundations import use_double

GOOD = {
    "S3": lambda p: p["total_variation"] < 0.05,
    "S5": lambda p: p["mean_error"] < 0.1 and p["sd_error"] < 0.05,
    "S6": right,
}
Rows = Sequence[Mapping[str, Any]]
FILE = OUTPUT / "active.jsonl"
PAGE = DOCS / "results" / "designs.md"
PARTS = ("s3", "s5", "s6", "failing", "stopping", "table")


def needed(course: Mapping[str, Any]) -> int | None:
    """Return the number of runs from which on the posterior is right; None if it is still wrong at the end."""
    good, found = GOOD[course["study"]], None
    for point in reversed(course["points"]):
        if not good(point):
            break
        found = point["runs"]
    return found


def _runs_table(courses: Rows) -> Table:
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


def _stopping_table(stopped: Rows) -> Table:
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


def _grouped(rows: Rows, keys: Sequence[str]) -> Iterator[tuple[tuple[Any, ...], list[Mapping[str, Any]]]]:
    groups = {tuple(row[key] for key in keys) for row in rows}
    for group in sorted(groups, key=str):
        yield group, [row for row in rows if tuple(row[key] for key in keys) == group]


def _tasks(part: str, seed: int, criterion: str, rules: tuple[str, ...]) -> Iterator[Callable[[], dict[str, Any]]]:
    if part == "stopping":
        yield partial(stopped, "S3", "refined", sensitivities=False, seed=seed)
        yield partial(stopped, "S3", "centre", sensitivities=True, seed=seed)
        yield partial(stopped, "S5", "refined", sensitivities=False, seed=seed)
    for gradients in (False, True):
        options = {"sensitivities": gradients, "criterion": criterion, "seed": seed}
        if part == "failing" and not gradients:
            yield from (partial(s3, "refined", options, most=30, share=share) for share in (0.1, 0.3))
        if part == "s5":
            yield partial(s5, "refined", options, most=30 if gradients else 60)
        if part == "s3":
            yield from (partial(s3, rule, options, most=12 if gradients else 20) for rule in rules)
        if part == "s6":
            first, most = (17, 45) if gradients else (58, 140)
            yield from (partial(s6, rule, options, first=first, most=most) for rule in rules)


def _compute(part: str, seeds: int, criterion: str, rules: tuple[str, ...], workers: int) -> None:
    use_double()
    truth_of(case("S3", "refined"))  # makes the table of true interfaces once, before the workers start
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=use_double) as pool:
        every = (task for seed in range(1, seeds + 1) for task in _tasks(part, seed, criterion, rules))
        jobs = [pool.submit(task) for task in every]
        for done, job in enumerate(as_completed(jobs), 1):
            if job.exception() is not None:
                print(f"{done}/{len(jobs)} FAILED: {job.exception()!r}", flush=True)
                continue
            course = job.result() | {"part": part}
            with FILE.open("a") as file:
                file.write(json.dumps(course) + "\n")
            last = course.get("points", [{}])[-1]
            print(f"{done}/{len(jobs)}", {k: v for k, v in course.items() if k != "points"}, last, flush=True)


def _main() -> None:
    defaults = {"seeds": 5, "criterion": "expected_variance", "quadrature": "", "workers": 2, "publish": False}
    given = arguments(__doc__, words=PARTS, **defaults)
    rules = (given.quadrature,) if given.quadrature else ("refined", "centre")
    for part in given.words:
        if part != "table":
            _compute(part, given.seeds, given.criterion, rules, given.workers)
            continue
        every = [json.loads(line) for line in FILE.read_text().splitlines()]
        tables = [_runs_table([one for one in every if "points" in one])]
        tables.append(_stopping_table([one for one in every if "points" not in one]))
        numbers = [table.as_json() for table in tables]
        show(tables, page=PAGE if given.publish else None, numbers="active-designs.json", content=numbers)


if __name__ == "__main__":
    _main()
