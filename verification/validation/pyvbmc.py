"""Active designs on a surrogate of the field compared with PyVBMC: runs of the model until the posterior is right.

Both start from nothing and call the same model, `validation.pyvbmc_problems`. After each batch (ours) or iteration
(theirs) the posterior is compared with the true one; a level is reached when the total variation is below it for the
first time. Overhead is the method's own processor time, without the model's. PyVBMC runs with its defaults; its
plausible bounds enclose the central 68 % of each prior. It boosts the posterior that it returns; for a fair comparison,
those of its iterations (of every fourth on the outline) are boosted too, as if it had ended there. A failed run has
log L = -inf, which PyVBMC refuses, so it needs an invented number.

Prints the tables, and writes verification/validation/output/pyvbmc.json; with ``--publish`` the tables go into the page
docs/results/peers.md and their raw numbers next to it. PyVBMC needs `make pyvbmc-env`; without it, a message says
so. It takes an hour on one core; finished runs are kept in output/pyvbmc and not repeated.

Run it with:  OMP_NUM_THREADS=1 python -m verification.validation.pyvbmc [--publish]
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from verification.benchmarks.peers.install import OWN, stamp
from verification.validation.pyvbmc_problems import Biofilm, Outline
from verification.validation.tables import DOCS, OUTPUT, Table, arguments, show, table

from strandline.design import sobol
from strandline.design.active import Active, learn, posterior_state
from strandline.design.active.choice import choose
from strandline.foundations import TooFewRuns, one_thread, use_double
from strandline.likelihood import InterfaceLikelihood

PAGE = DOCS / "results" / "peers.md"
KEPT = OUTPUT / "pyvbmc"
WORKER = Path(__file__).parents[1] / "benchmarks" / "peers" / "vbmc.py"
PEER = OWN["pyvbmc"][0]
SETTINGS = Active(runs=200)
PLAUSIBLE = 0.16
"""Probability below and above the plausible bounds."""
HELD = 3
"""Our side ends when it is below the last level after this many batches in a row."""
FAILED = {"biofilm": ("-1000", "lowest", "-inf"), "outline": ("-1000",)}
"""Log-likelihoods given to PyVBMC for failed runs; no run of the outline fails."""

Problem = Biofilm | Outline
Trace = dict[str, Any]
"""One method on one problem from one seed.

method, problem, seed, version; failed: log L given to PyVBMC for failed runs; runs and failures: their numbers; error:
what ended the run; final: total variation of the posterior that PyVBMC returns, after its own choice and boost. marks:
posteriors on the way, as runs of the model so far, total variation to the truth and the method's own CPU seconds;
boosted: those that PyVBMC would have returned if it had ended there.
"""
Answer = Callable[[Sequence[float]], dict[str, float | None]]


def _mark(runs: int, variation: float, overhead: float) -> dict[str, float]:
    return {"runs": runs, "variation": variation, "overhead": overhead}


def ours(problem: Problem, seed: int) -> Trace:
    """Make an active design of fixed batches, without the check that ends it, until it stays below the last level."""
    space, batch, most = problem.space, problem.batch, problem.most[0]
    marks, overhead = [], 0.0
    x = space.to_physical(sobol(4 + 2 * space.dim, space.dim, scramble=seed))
    records = [problem.run(row) for row in x]
    while True:
        begin = time.process_time()
        try:
            with one_thread():
                known = learn(x, records, space, problem.observations, problem.discrepancy)
                state = posterior_state(known, space, (seed, len(x)))
                options = {"explore": SETTINGS.explore, "criterion": SETTINGS.criterion, "seed": seed + 7919 * len(x)}
                picked = choose(state, space, batch, first=len(x), **options)
            overhead += time.process_time() - begin
            marks.append(_mark(len(x), problem.ours(known), overhead))
            print(f"  {problem.key}, seed {seed}: {marks[-1]}", flush=True)
        except TooFewRuns:
            overhead += time.process_time() - begin
            picked = space.to_physical(sobol(len(x) + batch, space.dim, scramble=seed)[len(x) :])
        held = [mark["variation"] < problem.levels[-1] for mark in marks[-HELD:]]
        if len(x) + batch > most or (len(held) == HELD and all(held)):
            break
        x = np.concatenate([x, picked])
        records += [problem.run(row) for row in picked]
    failures = sum(not record.ok for record in records)
    of = {"method": "strandline", "problem": problem.key, "failed": "", "seed": seed, "marks": marks}
    return of | {"runs": len(x), "failures": failures, "error": None}


def theirs(problem: Problem, seed: int, failed: str) -> Trace:
    """Answer PyVBMC's requests until it stops by itself or has used up its evaluations."""
    space, out = problem.space, KEPT / "peer.npz"
    ends = [space.prior_quantiles(np.full((1, space.dim), p))[0].tolist() for p in (PLAUSIBLE, 1 - PLAUSIBLE)]
    bounds = {"lower": space.low.tolist(), "upper": space.high.tolist()}
    bounds |= {"plausible_lower": ends[0], "plausible_upper": ends[1]}
    how = {"evaluations": problem.most[1], "seed": seed, "failed": failed, "boost": problem.boost, "out": str(out)}
    done = conversation({**bounds, **how, **problem.asked()}, answering(problem))
    with np.load(out) as content:
        variations = [problem.theirs(answer) for answer in content["posteriors"]]
    marks = [_mark(n, v, s) for (n, s), v in zip(done["iterations"], variations, strict=False)]
    end = len(done["iterations"])
    boosted = [_mark(n, v, s) for (n, s), v in zip(done["boosted"], variations[end + 1 :], strict=True)]
    of = {"method": "PyVBMC", "problem": problem.key, "failed": failed, "seed": seed, "marks": marks}
    ended = {"runs": done["evaluations"], "failures": done["failures"], "error": done["error"]}
    final = variations[end] if done["error"] is None else None
    return of | ended | {"final": final, "version": done["version"], "boosted": boosted}


def answering(problem: Problem) -> Answer:
    """Return a function that answers with the log prior and, unless the run fails, the log joint density."""
    likelihood = InterfaceLikelihood(problem.observations, problem.discrepancy)

    def answer(x: Sequence[float]) -> dict[str, float | None]:
        at = np.array(x)
        record, prior = problem.run(at), float(problem.space.log_prior(at))
        return {"y": likelihood(record.interfaces) + prior if record.ok else None, "prior": prior}

    return answer


def conversation(task: Mapping[str, object], answer: Answer) -> dict[str, Any]:
    """Start the peer's process, answer its requests, and return its last message."""
    limited = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    command = [str(PEER / "bin" / "python"), str(WORKER)]
    with subprocess.Popen(command, text=True, bufsize=1, env=limited, **pipes) as process:
        process.stdin.write(json.dumps(task) + "\n")
        for line in process.stdout:
            said = json.loads(line)
            if "done" in said:
                return said["done"]
            process.stdin.write(json.dumps(answer(said["x"])) + "\n")
    raise RuntimeError(f"PyVBMC's process ended without its last message, exit status {process.returncode}")


def kept(name: str, make: Callable[[], Trace]) -> Trace:
    """Return a kept run of either method; if there is none, make it."""
    path = KEPT / f"{name}.json"
    if not path.exists():
        begin = time.perf_counter()
        path.write_text(json.dumps(make()), "utf-8")
        print(f"{name}: {time.perf_counter() - begin:.0f} s", flush=True)
    return json.loads(path.read_text("utf-8"))


def _traces(problem: Problem, *, peer: bool) -> Iterator[Trace]:
    seeds = range(1, problem.seeds + 1)
    for seed in seeds:
        yield kept(f"{problem.key}-ours-{seed}", partial(ours, problem, seed))
    for failed in FAILED[problem.key] if peer else ():
        for seed in seeds:
            yield kept(f"{problem.key}-pyvbmc{failed}-{seed}", partial(theirs, problem, seed, failed))


def compared(problem: Problem, found: Sequence[Trace]) -> Iterator[tuple]:
    """Yield a row for each level and each value given to PyVBMC for failed runs."""
    mine = [trace for trace in found if trace["method"] == "strandline"]
    for failed in sorted({trace["failed"] for trace in found if trace["method"] == "PyVBMC"} - {"-inf"}) or [""]:
        other = [trace for trace in found if trace["method"] == "PyVBMC" and trace["failed"] == failed]
        told = failed if any(trace["failures"] for trace in other) else "–"
        for level in problem.levels:
            text, runs, seconds = figures(mine, level)
            peers = figures(other, level), figures(other, level, "boosted")
            texts, medians, overheads = zip(*peers, strict=True)
            ratios = [one / runs if runs and one else None for one in medians]
            seeds = f"{len(mine)}, {len(other)}"
            yield problem.title, told, level, seeds, text, *texts, *ratios, seconds, *overheads


def figures(found: Sequence[Trace], level: float, marks: str = "marks") -> tuple[str, float | None, float | None]:
    """Return median and worst number of runs until `level` in words, the median, and the median overhead.

    A seed that never reached the level counts as the worst; without a median there are None.
    """
    if not found:
        return "not measured", None, None
    first = [next((mark for mark in trace[marks] if mark["variation"] < level), None) for trace in found]
    there = [mark["runs"] for mark in first if mark is not None]
    never = f"not by {len(found) - len(there)} of {len(found)}"
    middle, seconds = (
        median([float("inf") if mark is None else float(mark[key]) for mark in first]) for key in ("runs", "overhead")
    )
    if not np.isfinite(middle):
        return never, None, None
    return f"{middle:g} / {never if len(there) < len(found) else max(there)}", middle, seconds


def endings(problem: Problem, found: Sequence[Trace]) -> Iterator[tuple[str, ...]]:
    """Yield how PyVBMC's runs ended, and how close the returned posterior is to the truth."""
    for failed in FAILED[problem.key]:
        of_them = [trace for trace in found if trace["method"] == "PyVBMC" and trace["failed"] == failed]
        if not of_them:
            continue
        final = [trace["final"] for trace in of_them if trace["final"] is not None]
        runs, failures = ([trace[name] for trace in of_them] for name in ("runs", "failures"))
        raised = f"{sum(trace['error'] is not None for trace in of_them)} of {len(of_them)}"
        ranges = (f"{min(some)} to {max(some)}" for some in (runs, failures))
        spread = f"{median(final):.3f} / {max(final):.3f}" if final else ""
        yield problem.title, failed if any(failures) else "–", raised, *ranges, spread


def tables(found: Mapping[str, Sequence[Trace]], problems: Sequence[Problem]) -> list[Table]:
    """Return the comparison, how PyVBMC ended, and the accuracy of the true posteriors."""
    comparison = [row for problem in problems for row in compared(problem, found[problem.key])]
    ends = [row for problem in problems for row in endings(problem, found[problem.key])]
    accuracy = [(p.title, what, value) for p in problems for what, value in p.accuracy().items()]
    heading = (
        "problem | log L given for a failure | below {.2f} | seeds | strandline, runs | PyVBMC, runs "
        "| PyVBMC boosted, runs | ratio {.1f} | ratio, boosted {.1f} | strandline, overhead [CPU s] {.0f} "
        "| PyVBMC, overhead [CPU s] {.0f} | boosted [CPU s] {.0f}"
    )
    end = "problem | log L given for a failure | ended by an exception | evaluations | failed runs | returned"
    titles = (
        "Runs of the model until the total variation to the true posterior is below a level: median / worst",
        "How PyVBMC ended, and the total variation of what it returned: median / worst",
        "What the true posteriors are worth",
    )
    return [
        table("pyvbmc", titles[0], heading, comparison),
        table("pyvbmc-end", titles[1], end, ends),
        table("pyvbmc-truth", titles[2], "problem | figure | value {.3g}", accuracy),
    ]


def _main() -> None:
    options = arguments(__doc__, publish=False)
    missing = None if stamp(PEER).exists() else "PyVBMC is not measured: make pyvbmc-env installs it"
    if missing:
        print(missing, file=sys.stderr)
    use_double()
    KEPT.mkdir(parents=True, exist_ok=True)
    problems = (Biofilm(KEPT), Outline(KEPT))
    found = {problem.key: [*_traces(problem, peer=missing is None)] for problem in problems}
    made = tables(found, problems)
    traces = [trace for one in found.values() for trace in one]
    errors = sorted({trace["error"] for trace in traces if trace["error"]})
    raw = {"tables": {one.name: one.as_json() for one in made}, "errors": errors, "missing": missing, "traces": traces}
    show(made, page=PAGE if options.publish else None, numbers="pyvbmc.json", content=raw)
    print("".join(f"\nException: `{error}`\n" for error in errors))


if __name__ == "__main__":
    _main()
