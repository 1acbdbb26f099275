"""Active designs on a surrogate of the field compared with PyVBMC: runs of the model until the posterior is right.

Both start from nothing and call the same model, `validation.pyvbmc_problems`. After each batch (ours) or iteration
(theirs) the posterior is compared with the true one; a level is reached when the total variation is below it for the
first time. Overhead is the method's own processor time, without the model's. PyVBMC runs with its defaults; its
plausible bounds enclose the central 68 % of each prior. It boosts the posterior that it returns; for a fair comparison,
those of its iterations (of every fourth on the outline) are boosted too, as if it had ended there. A failed run has
log L = -inf, which PyVBMC refuses, so it needs an invented number.

Writes verification/validation/output/pyvbmc.md and .json; with ``--publish`` the tables also go into the page
docs/results/peers.md and their raw numbers next to it. PyVBMC needs `make pyvbmc-env`; without it, a message says
so. It takes an hour on one core; finished runs are kept in output/pyvbmc and not repeated. With ``--at-hand`` nothing
is run, and the tables show only kept runs.

Run it with:  OMP_NUM_THREADS=1 python -m verification.validation.pyvbmc [--publish] [--at-hand]
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import jax
import numpy as np
from verification.benchmarks.peers.install import OWN, not_installed
from verification.validation.pyvbmc_problems import Biofilm, Outline
from verification.validation.tables import Cell, Table, put_into_page

from strandline.design import sobol
from strandline.design.active import Active, learn, posterior_state
from strandline.design.active.choice import choose
from strandline.errors import TooFewRuns
from strandline.likelihood import InterfaceLikelihood
from strandline.numerics.threads import one_thread

OUTPUT = Path(__file__).parent / "output"
PAGE = Path(__file__).parents[2] / "docs" / "results" / "peers.md"
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


@dataclass(frozen=True)
class Mark:
    """An intermediate posterior.

    Args:
        runs: Number of runs of the model so far.
        variation: Total variation to the truth.
        overhead: The method's own processor seconds so far.
    """

    runs: int
    variation: float
    overhead: float


@dataclass(frozen=True)
class Trace:
    """One method on one problem from one seed.

    Args:
        method: ``strandline`` or ``PyVBMC``.
        problem: Key of the problem.
        failed: Log L given to PyVBMC for failed runs; empty for ours.
        seed: Seed of the random numbers.
        marks: Marks after each batch or iteration.
        runs: Total number of runs.
        failures: Number of failed runs.
        error: Error that ended the run, or None.
        final: Total variation of the posterior that PyVBMC returns, after its own choice and boost; None for ours.
        version: Version of the method.
        boosted: Marks of the boosted posteriors that PyVBMC would have returned if it had ended there.
    """

    method: str
    problem: str
    failed: str
    seed: int
    marks: tuple[Mark, ...]
    runs: int
    failures: int
    error: str | None = None
    final: float | None = None
    version: str = ""
    boosted: tuple[Mark, ...] = ()

    def reached(self, level: float, *, boosted: bool = False) -> Mark | None:
        """Return the first mark below `level`."""
        return next((mark for mark in (self.boosted if boosted else self.marks) if mark.variation < level), None)


def ours(problem: Problem, seed: int) -> Trace:
    """Make an active design of fixed batches, without the check that ends it, until it stays below the last level."""
    space, batch, most = problem.space, problem.batch, problem.most[0]
    marks, overhead = list[Mark](), 0.0
    x = space.to_physical(sobol(4 + 2 * space.dim, space.dim, scramble=seed))
    records = [problem.run(row) for row in x]
    while True:
        begin = time.process_time()
        try:
            with one_thread():
                known = learn(x, records, space, problem.observations, problem.discrepancy)
                state = posterior_state(known, space, (seed, len(x)))
                picked = choose(
                    state,
                    space,
                    batch,
                    explore=SETTINGS.explore,
                    first=len(x),
                    criterion=SETTINGS.criterion,
                    seed=seed + 7919 * len(x),
                )
            overhead += time.process_time() - begin
            marks.append(Mark(len(x), problem.ours(known), overhead))
            print(f"  {problem.key}, seed {seed}: {marks[-1]}", flush=True)
        except TooFewRuns:
            overhead += time.process_time() - begin
            picked = space.to_physical(sobol(len(x) + batch, space.dim, scramble=seed)[len(x) :])
        held = [mark.variation < problem.levels[-1] for mark in marks[-HELD:]]
        if len(x) + batch > most or (len(held) == HELD and all(held)):
            break
        x = np.concatenate([x, picked])
        records += [problem.run(row) for row in picked]
    failures = sum(not record.ok for record in records)
    return Trace("strandline", problem.key, "", seed, tuple(marks), len(x), failures)


def theirs(problem: Problem, seed: int, failed: str) -> Trace:
    """Answer PyVBMC's requests until it stops by itself or has used up its evaluations."""
    space, out = problem.space, OUTPUT / "pyvbmc" / "peer.npz"
    ends = [space.prior_quantiles(np.full((1, space.dim), p))[0].tolist() for p in (PLAUSIBLE, 1 - PLAUSIBLE)]
    task = {
        "lower": space.low.tolist(),
        "upper": space.high.tolist(),
        "plausible_lower": ends[0],
        "plausible_upper": ends[1],
        "evaluations": problem.most[1],
        "seed": seed,
        "failed": failed,
        "boost": problem.boost,
        "out": str(out),
        **problem.asked(),
    }
    done = conversation(task, answering(problem))
    with np.load(out) as content:
        variations = [problem.theirs(answer) for answer in content["posteriors"]]
    marks = tuple(Mark(n, v, s) for (n, s), v in zip(done["iterations"], variations, strict=False))
    end = len(done["iterations"])
    final = variations[end] if done["error"] is None else None
    boosted = tuple(Mark(n, v, s) for (n, s), v in zip(done["boosted"], variations[end + 1 :], strict=True))
    return Trace(
        "PyVBMC",
        problem.key,
        failed,
        seed,
        marks,
        done["evaluations"],
        done["failures"],
        done["error"],
        final,
        done["version"],
        boosted,
    )


def answering(problem: Problem) -> Callable[[Sequence[float]], Mapping[str, float | None]]:
    """Return a function that answers with the log prior and, unless the run fails, the log joint density."""
    likelihood = InterfaceLikelihood(problem.observations, problem.discrepancy)

    def answer(x: Sequence[float]) -> Mapping[str, float | None]:
        at = np.array(x)
        record, prior = problem.run(at), float(problem.space.log_prior(at))
        return {"y": likelihood(record.interfaces) + prior if record.ok else None, "prior": prior}

    return answer


def conversation(
    task: Mapping[str, object],
    answer: Callable[[Sequence[float]], Mapping[str, float | None]],
    python: Path = PEER / "bin" / "python",
    *,
    script: Path = WORKER,
) -> Mapping[str, Any]:
    """Start the peer's process, answer its requests, and return its last message."""
    limited = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(
        [str(python), str(script)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=limited,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(task) + "\n")
        process.stdin.flush()
        for line in process.stdout:
            said = json.loads(line)
            if "done" in said:
                done: Mapping[str, Any] = said["done"]
                return done
            process.stdin.write(json.dumps(answer(said["x"])) + "\n")
            process.stdin.flush()
    raise RuntimeError(f"PyVBMC's process ended without its last message, exit status {process.returncode}")


def kept(name: str, make: Callable[[], Trace], *, at_hand: bool) -> list[Trace]:
    """Return a kept run of either method; if there is none, make it, or leave it out with `at_hand`."""
    path = OUTPUT / "pyvbmc" / f"{name}.json"
    if not path.exists() and at_hand:
        return []
    if not path.exists():
        begin = time.perf_counter()
        path.write_text(json.dumps(asdict(make())), "utf-8")
        print(f"{name}: {time.perf_counter() - begin:.0f} s", flush=True)
    found = json.loads(path.read_text("utf-8"))
    marks = {name: tuple(Mark(**mark) for mark in found[name]) for name in ("marks", "boosted")}
    return [Trace(**found | marks)]


def traces(problem: Problem, *, peer: bool, at_hand: bool) -> list[Trace]:
    """Return all runs of both methods on a problem."""
    seeds = range(1, problem.seeds + 1)
    makers = {f"{problem.key}-ours-{seed}": partial(ours, problem, seed) for seed in seeds}
    for failed in FAILED[problem.key] if peer else ():
        makers |= {f"{problem.key}-pyvbmc{failed}-{seed}": partial(theirs, problem, seed, failed) for seed in seeds}
    return [trace for name, make in makers.items() for trace in kept(name, make, at_hand=at_hand)]


def compared(problem: Problem, found: Sequence[Trace]) -> list[tuple[Cell, ...]]:
    """Return a row for each level and each value given to PyVBMC for failed runs."""
    mine = [trace for trace in found if trace.method == "strandline"]
    peers = sorted({trace.failed for trace in found if trace.method == "PyVBMC"} - {"-inf"}) or [""]
    rows: list[tuple[Cell, ...]] = []
    for failed in peers:
        other = [trace for trace in found if trace.method == "PyVBMC" and trace.failed == failed]
        told = failed if any(trace.failures for trace in other) else "–"
        for level in problem.levels:
            a, b, c = figures(mine, level), figures(other, level), figures(other, level, boosted=True)
            ratios = [one.median / a.median if a.median and one.median else None for one in (b, c)]
            seeds = f"{len(mine)}, {len(other)}"
            cells = (a.text, b.text, c.text, *ratios, a.overhead, b.overhead, c.overhead)
            rows.append((problem.title, told, level, seeds, *cells))
    return rows


@dataclass(frozen=True)
class Figures:
    """Runs until a level is reached, over several seeds; None if too few seeds reached it."""

    text: str
    median: float | None
    overhead: float | None


def figures(found: Sequence[Trace], level: float, *, boosted: bool = False) -> Figures:
    """Return median and worst number of runs until `level`; a seed that never reached it counts as the worst."""
    if not found:
        return Figures("not measured", None, None)
    marks = [trace.reached(level, boosted=boosted) for trace in found]
    there = [mark for mark in marks if mark is not None]
    never = f"not by {len(found) - len(there)} of {len(found)}"
    middle = median([float("inf") if mark is None else float(mark.runs) for mark in marks])
    if not np.isfinite(middle):
        return Figures(never, None, None)
    worst = never if len(there) < len(found) else f"{max(mark.runs for mark in there)}"
    seconds = median([float("inf") if mark is None else mark.overhead for mark in marks])
    return Figures(f"{middle:g} / {worst}", middle, seconds)


def endings(problem: Problem, found: Sequence[Trace]) -> list[tuple[Cell, ...]]:
    """Return how PyVBMC's runs ended, and how close the returned posterior is to the truth."""
    rows: list[tuple[Cell, ...]] = []
    for failed in FAILED[problem.key]:
        of_them = [trace for trace in found if trace.method == "PyVBMC" and trace.failed == failed]
        if not of_them:
            continue
        final = [trace.final for trace in of_them if trace.final is not None]
        runs, failures = ([getattr(t, name) for t in of_them] for name in ("runs", "failures"))
        raised = sum(trace.error is not None for trace in of_them)
        told = failed if any(failures) else "–"
        spread = f"{median(final):.3f} / {max(final):.3f}" if final else ""
        rows.append(
            (
                problem.title,
                told,
                f"{raised} of {len(of_them)}",
                f"{min(runs)} to {max(runs)}",
                f"{min(failures)} to {max(failures)}",
                spread,
            )
        )
    return rows


def tables(found: Mapping[str, Sequence[Trace]], problems: Sequence[Problem]) -> list[Table]:
    """Return the comparison, how PyVBMC ended, and the accuracy of the true posteriors."""
    comparison = [row for problem in problems for row in compared(problem, found[problem.key])]
    ends = [row for problem in problems for row in endings(problem, found[problem.key])]
    accuracy = [(p.title, what, value) for p in problems for what, value in p.accuracy().items()]
    return [
        Table(
            "pyvbmc",
            "Runs of the model until the total variation to the true posterior is below a level: median / worst",
            (
                "problem",
                "log L given for a failure",
                "below",
                "seeds",
                "strandline, runs",
                "PyVBMC, runs",
                "PyVBMC boosted, runs",
                "ratio",
                "ratio, boosted",
                "strandline, overhead [CPU s]",
                "PyVBMC, overhead [CPU s]",
                "boosted [CPU s]",
            ),
            ("s", "s", ".2f", "s", "s", "s", "s", ".1f", ".1f", ".0f", ".0f", ".0f"),
            tuple(comparison),
        ),
        Table(
            "pyvbmc-end",
            "How PyVBMC ended, and the total variation of what it returned: median / worst",
            ("problem", "log L given for a failure", "ended by an exception", "evaluations", "failed runs", "returned"),
            ("s",) * 6,
            tuple(ends),
        ),
        Table(
            "pyvbmc-truth",
            "What the true posteriors are worth",
            ("problem", "figure", "value"),
            ("s", "s", ".3g"),
            tuple(accuracy),
        ),
    ]


def missing_peer(peer: Path = PEER) -> str | None:
    """Return why PyVBMC cannot be measured, or None."""
    if (peer / "bin" / "python").exists() and not not_installed(peer):
        return None
    return f"PyVBMC is not measured: {not_installed(peer) or 'it is not installed; make pyvbmc-env does'}"


def main(arguments: Sequence[str]) -> None:
    """Run everything that is not kept; see the module's docstring."""
    jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]
    folder = OUTPUT / "pyvbmc"
    folder.mkdir(parents=True, exist_ok=True)
    missing = missing_peer()
    if missing:
        print(missing, file=sys.stderr)
    problems = (Biofilm(folder), Outline(folder))
    found = {
        problem.key: traces(problem, peer=missing is None, at_hand="--at-hand" in arguments) for problem in problems
    }
    made = tables(found, problems)
    errors = sorted({trace.error for one in found.values() for trace in one if trace.error})
    raw = {
        "tables": {table.name: table.as_json() for table in made},
        "errors": errors,
        "missing": missing,
        "traces": [asdict(trace) for one in found.values() for trace in one],
    }
    text = json.dumps(raw, indent=1, ensure_ascii=False) + "\n"
    shown = "\n".join(f"## {table.title}\n\n{table.markdown()}\n" for table in made)
    said = "".join(f"\nException: `{error}`\n" for error in errors)
    (OUTPUT / "pyvbmc.json").write_text(text, "utf-8")
    (OUTPUT / "pyvbmc.md").write_text(f"# Active designs compared with PyVBMC\n\n{shown}{said}", "utf-8")
    if "--publish" in arguments:
        PAGE.with_name("pyvbmc.json").write_text(text, "utf-8")
        PAGE.write_text(put_into_page(PAGE.read_text("utf-8"), made), "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
