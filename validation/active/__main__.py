"""`python -m validation.active PART …`: make the figures of a part for several seeds, in two processes.

Parts: s3, s5, s6 (runs until the posterior is right), failing (runs that fail at random), stopping (where whole
calibrations stop). Courses are appended to
validation/output/active.jsonl; `python -m validation.active table` prints the tables made of all of them.
"""

import argparse
import json
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

from validation.active.cases import OUTPUT, case, truth_of
from validation.active.table import tables
from validation.active.work import start, tasks

FILE = OUTPUT / "active.jsonl"


def main() -> None:
    """Run a part, or print the tables."""
    parser = argparse.ArgumentParser(prog="python -m validation.active")
    parser.add_argument("part", choices=["s3", "s5", "s6", "failing", "stopping", "table"])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--criterion", default="expected_variance")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    if given.part == "table":
        print(tables([json.loads(line) for line in FILE.read_text().splitlines()]))
        return
    start()
    truth_of(case("S3", "refined"))  # the table of true interfaces is made here, once
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn"), initializer=start) as pool:
        jobs = [pool.submit(task) for task in tasks(given.part, given.seeds, given.criterion)]
        for done, job in enumerate(as_completed(jobs), 1):
            error = job.exception()
            if error is not None:
                print(f"{done}/{len(jobs)} FAILED: {error!r}", flush=True)
                continue
            course = asdict(job.result()) | {"part": given.part}
            with Path(FILE).open("a") as file:
                file.write(json.dumps(course) + "\n")
            last = course.get("points", [{}])[-1]
            print(f"{done}/{len(jobs)}", {k: v for k, v in course.items() if k != "points"}, last, flush=True)


if __name__ == "__main__":
    main()
