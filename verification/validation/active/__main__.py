"""Active designs on a surrogate of the field, compared with the true model, for several seeds and in two processes.

    python -m verification.validation.active PART … [--seeds 5] [--criterion NAME] [--quadrature refined|centre]
        [--workers 2] [--publish]

Parts: s3, s5, s6 (runs until the posterior is right), failing (runs that fail at random), stopping (where whole
calibrations stop). Results are appended to ../output/active.jsonl; the part ``table`` prints tables of all of them, and
with ``--publish`` puts them into docs/results/designs.md and their numbers into active-designs.json next to it.
All parts take two hours on two cores. A quadrature restricts s3 and s6 to this one.
"""

import json
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context
from typing import Any

from verification.validation.active.accuracy import s3, s5, s6
from verification.validation.active.cases import case, truth_of
from verification.validation.active.stopping import stopped
from verification.validation.active.table import runs_table, stopping_table
from verification.validation.tables import DOCS, OUTPUT, arguments, as_text, show

from strandline.numerics.threads import use_double

FILE = OUTPUT / "active.jsonl"
PAGE = DOCS / "results" / "designs.md"
PARTS = ("s3", "s5", "s6", "failing", "stopping", "table")


def tasks(part: str, seed: int, criterion: str, rules: tuple[str, ...]) -> Iterator[Callable[[], dict[str, Any]]]:
    """Yield the tasks of a part for one seed."""
    common = {"seed": seed, "criterion": criterion}
    if part == "stopping":
        yield partial(stopped, "S3", "refined", sensitivities=False, seed=seed)
        yield partial(stopped, "S3", "centre", sensitivities=True, seed=seed)
        yield partial(stopped, "S5", "refined", sensitivities=False, seed=seed)
    if part == "failing":
        for share in (0.1, 0.3):
            yield partial(s3, "refined", sensitivities=False, most=30, share=share, **common)
    for gradients in (False, True):
        if part == "s5":
            yield partial(s5, "refined", sensitivities=gradients, most=30 if gradients else 60, **common)
        for rule in rules if part == "s3" else ():
            yield partial(s3, rule, sensitivities=gradients, most=12 if gradients else 20, **common)
        for rule in rules if part == "s6" else ():
            first, most = (17, 45) if gradients else (58, 140)
            yield partial(s6, rule, sensitivities=gradients, batch=4, first=first, most=most, **common)


def compute(part: str, seeds: int, criterion: str, rules: tuple[str, ...], workers: int) -> None:
    """Run the tasks of a part and append their results to the file."""
    use_double()
    truth_of(case("S3", "refined"))  # makes the table of true interfaces once, before the workers start
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=use_double) as pool:
        every = (task for seed in range(1, seeds + 1) for task in tasks(part, seed, criterion, rules))
        jobs = [pool.submit(task) for task in every]
        for done, job in enumerate(as_completed(jobs), 1):
            error = job.exception()
            if error is not None:
                print(f"{done}/{len(jobs)} FAILED: {error!r}", flush=True)
                continue
            course = job.result() | {"part": part}
            with FILE.open("a") as file:
                file.write(json.dumps(course) + "\n")
            last = course.get("points", [{}])[-1]
            print(f"{done}/{len(jobs)}", {k: v for k, v in course.items() if k != "points"}, last, flush=True)


def main() -> None:
    """Run the parts, or print the tables."""
    defaults = {"seeds": 5, "criterion": "expected_variance", "quadrature": "", "workers": 2, "publish": False}
    given = arguments(__doc__, words=PARTS, **defaults)
    rules = (given.quadrature,) if given.quadrature else ("refined", "centre")
    for part in given.words:
        if part != "table":
            compute(part, given.seeds, given.criterion, rules, given.workers)
            continue
        every = [json.loads(line) for line in FILE.read_text().splitlines()]
        tables = [runs_table([one for one in every if "points" in one])]
        tables.append(stopping_table([one for one in every if "points" not in one]))
        show(tables, page=PAGE if given.publish else None)
        if given.publish:
            numbers = [table.as_json() for table in tables]
            PAGE.with_name("active-designs.json").write_text(as_text(numbers), "utf-8")


if __name__ == "__main__":
    main()
