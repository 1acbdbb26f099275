"""`python -m verification.validation.active PART …`: compute the figures of a part for several seeds, in two processes.

Parts: s3, s5, s6 (runs until the posterior is right), failing (runs that fail at random), stopping (where whole
calibrations stop). Results are appended to ../output/active.jsonl; the part ``table`` prints tables of all of them, and
with ``--publish`` puts them into docs/results/designs.md and their numbers into active-designs.json next to it.
All parts take two hours on two cores.
"""

import argparse
import json
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

from verification.validation.active.cases import OUTPUT, case, truth_of
from verification.validation.active.table import runs_table, stopping_table
from verification.validation.active.work import start, tasks
from verification.validation.tables import put_into_page

FILE = OUTPUT / "active.jsonl"
PAGE = Path("docs/results/designs.md")
NUMBERS = PAGE.with_name("active-designs.json")


def main() -> None:
    """Run a part, or print the tables."""
    parser = argparse.ArgumentParser(prog="python -m verification.validation.active")
    parser.add_argument("part", choices=["s3", "s5", "s6", "failing", "stopping", "table"])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--criterion", default="expected_variance")
    parser.add_argument("--quadrature", choices=["refined", "centre"], help="only this one, of s3 and s6")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--publish", action="store_true", help="put the tables into the page")
    given = parser.parse_args()
    if given.part == "table":
        show(publish=given.publish)
        return
    start()
    truth_of(case("S3", "refined"))  # makes the table of true interfaces once, before the workers start
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn"), initializer=start) as pool:
        jobs = [pool.submit(task) for task in tasks(given.part, given.seeds, given.criterion, given.quadrature)]
        for done, job in enumerate(as_completed(jobs), 1):
            error = job.exception()
            if error is not None:
                print(f"{done}/{len(jobs)} FAILED: {error!r}", flush=True)
                continue
            course = asdict(job.result()) | {"part": given.part}
            with FILE.open("a") as file:
                file.write(json.dumps(course) + "\n")
            last = course.get("points", [{}])[-1]
            print(f"{done}/{len(jobs)}", {k: v for k, v in course.items() if k != "points"}, last, flush=True)


def show(*, publish: bool) -> None:
    """Print the tables of all results so far, and publish them if asked."""
    every = [json.loads(line) for line in FILE.read_text().splitlines()]
    tables = [runs_table([one for one in every if "points" in one])]
    tables.append(stopping_table([one for one in every if "points" not in one]))
    for table in tables:
        print(f"{table.title}\n\n{table.markdown()}\n")
    if publish:
        PAGE.write_text(put_into_page(PAGE.read_text(), tables))
        NUMBERS.write_text(json.dumps([table.as_json() for table in tables], indent=1) + "\n")


if __name__ == "__main__":
    main()
