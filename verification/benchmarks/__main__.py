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
from verification.benchmarks.aims import with_aims
from verification.benchmarks.figures import Figure
from verification.benchmarks.results import PARTS

from strandline.cli.main import environment

ALONE = "--here"
HERE = "verification.benchmarks"


def _main(arguments: list[str]) -> int:
    if arguments[:1] == [ALONE]:
        (part,) = arguments[1:]
        results.save(part, measured(part))
        return 0
    if not set(arguments) <= set(PARTS):
        sys.exit(f"usage: python -m {HERE} [{'|'.join(PARTS)}]")
    print(f"{os.cpu_count()} cores, OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'unset')}")
    if not arguments or not results.this_machine().items() <= results.machine_of_results().items():
        print("all earlier results are dropped")
        for path in (results.RESULTS, results.MACHINE, results.SCALING):
            path.unlink(missing_ok=True)
    failed = [part for part in arguments or PARTS if not run(part)]
    print(f"\nwritten: {results.RESULTS}")
    for figure, aim in with_aims(results.load()):
        if aim.met(figure) is False:
            print(f"aim missed: {figure.task}: {aim.value(figure):.3g}, aim {aim.bound:g}")
    return 1 if failed else 0


def measured(part: str) -> list[Figure]:
    """Return the figures of a part; print each as soon as it is measured."""
    widths = (52, 34, 20, 20, 6, 6, 0)
    titles = ("task", "against", "strandline", "other", "ratio", "core", "remark")
    print("  ".join(f"{title:{width}}" for title, width in zip(titles, widths, strict=True)))
    found = []
    for figure in importlib.import_module(f"{HERE}.{part}").figures():
        found.append(figure)
        cells = zip(results.row(figure), widths, strict=True)
        print("  ".join(f"{cell:{width}}" for cell, width in cells).rstrip(), flush=True)
    return found


def run(part: str) -> bool:
    """Run a part in its own process; if it failed, write a line into the results and return False.

    JAX fixes its devices when it starts, so the sampler's process starts as the command line does.
    """
    print(f"\n{part}", flush=True)
    (load, *_), begun = os.getloadavg(), time.perf_counter()
    devices = environment() if part == "sampler" else {}
    status = subprocess.run([sys.executable, "-m", HERE, ALONE, part], env={**devices, **os.environ}).returncode
    seconds = time.perf_counter() - begun
    if status:
        results.save(part, [Figure(part, unit="", remark=f"the part ended with status {status}")])
        print(f"{part}: not measured")
    results.note_run(part, seconds=seconds, load_average=load)
    return status == 0


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1:]))
