"""`make bench`: ``python -m verification.benchmarks [PART ...]``, all parts if none is named, each in its own process.

Each part prints its figures and writes them to ``results.json`` in place of its earlier ones. If a part fails, its
figures are missing, and the list says so. Exit status 1: a part failed. Missed aims are printed.
"""

import importlib
import os
import subprocess
import sys
import time

from verification.benchmarks import results

PARTS = ("inference", "surrogate", "sampler", "norms", "executors", "startup", "forward", "scaling")
ALONE = "--here"
HERE = "verification.benchmarks"


def main(arguments: list[str]) -> int:
    if arguments[:1] == [ALONE]:
        (part,) = arguments[1:]
        results.save(part, importlib.import_module(f"{HERE}.{part}").main(), parts=PARTS)
        return 0
    if not set(arguments) <= set(PARTS):
        sys.exit(f"usage: python -m verification.benchmarks [{'|'.join(PARTS)}]")
    print(f"{os.cpu_count()} cores, OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'unset')}")
    if not arguments or not results.from_this_machine():
        print("all earlier results are dropped" if results.RESULTS.exists() else "")
        results.forget()
    failed = [part for part in arguments or PARTS if not run(part)]
    missed = [record for record in results.load() if record["met"] is False]
    print(f"\nwritten: {results.RESULTS}")
    for record in missed:
        figure = record["ours"] if record["ratio"] is None else record["ratio"]
        print(f"aim missed: {record['what']} {record.get('case', '')}: {figure:.3g}, aim {record['aim']:g}")
    return 1 if failed else 0


def run(part: str) -> bool:
    """Run a part in its own process; if it failed, write a line into the results and return False."""
    print(f"\n{part}", flush=True)
    load, begun = results.load_average(), time.perf_counter()
    status = subprocess.run([sys.executable, "-m", HERE, ALONE, part]).returncode
    seconds = time.perf_counter() - begun
    if status:
        why = f"the part ended with status {status}"
        results.save(part, [{"what": part, "value": None, "unit": "", "remark": why}], parts=PARTS)
        print(f"{part}: not measured, {why}")
    results.note_run(part, seconds=seconds, load_average=load)
    return status == 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
