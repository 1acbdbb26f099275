"""PyVBMC in its own process; the process that started it computes the log joint density at each point.

It reads a task, one line of JSON, and writes one line for each evaluation, ``{"x": [...]}``; the answer is
``{"y": log joint density}``, or ``{"y": null, "prior": log prior density}`` if the run failed. The last line is
``{"done": ...}``. The variational posterior after each iteration goes into an .npz: its density at given points
(``at``, an .npz with ``points``) or draws from it (``draws``). It knows nothing about strandline.

Task: ``lower``, ``upper``, ``plausible_lower``, ``plausible_upper``, ``evaluations`` (largest number), ``seed``,
``failed`` (the log-likelihood of a failed run: ``-inf``, a number, or ``lowest`` of those seen), ``at`` or ``draws``,
``out``, and ``boost``: afterwards, the posterior of every ``boost``-th iteration is boosted, as PyVBMC would have done
if it had ended there.
"""

import json
import os
import sys
import time
from importlib import metadata
from typing import Any

from worker import say

FIRST_LOWEST = -1e3
"""Used as the lowest log-likelihood if a run fails before any has succeeded."""


class Target:
    """The log joint density, requested over a pipe; waiting for the answer takes no processor time."""

    def __init__(self, failed: str, replies: Any) -> None:
        self.failed, self.replies = failed, replies
        self.evaluations = self.failures = 0
        self.lowest: float | None = None

    def __call__(self, x: Any) -> float:
        say(self.replies, x=[float(value) for value in x])
        answer = json.loads(sys.stdin.readline())
        self.evaluations += 1
        if answer["y"] is not None:
            seen = answer["y"] - answer["prior"]
            self.lowest = seen if self.lowest is None else min(self.lowest, seen)
            return float(answer["y"])
        self.failures += 1
        return self._invented() + float(answer["prior"])

    def _invented(self) -> float:
        if self.failed != "lowest":
            return float(self.failed)
        return FIRST_LOWEST if self.lowest is None else self.lowest


def boosts(vbmc: Any, every: int, marks: dict[int, tuple[int, float]]) -> list[tuple[tuple[int, float], Any]]:
    """Return the mark and the boosted posterior of each `every`-th iteration; its seconds include the boost.

    A boost uses the iteration's posterior and Gaussian process, but no later evaluation.
    """
    found = []
    for k in sorted(marks)[every - 1 :: every]:
        begin = time.process_time()
        vp = vbmc.final_boost(vbmc.iteration_history["vp"][k], vbmc.get_gp(k))[0]
        evaluations, seconds = marks[k]
        found.append(((evaluations, seconds + time.process_time() - begin), vp))
    return found


def _main() -> None:
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # keep what libraries print out of the replies
    import numpy as np
    from pyvbmc import VBMC

    task = json.loads(sys.stdin.readline())
    target = Target(task["failed"], replies)
    marks: dict[int, tuple[int, float]] = {}
    error, vbmc, begin, overhead, boosted = None, None, time.process_time(), 0.0, []
    try:
        bounds = [np.array(task[key]) for key in ("lower", "upper", "plausible_lower", "plausible_upper")]
        options = {"max_fun_evals": task["evaluations"], "display": "off", "show_tips": False}
        vbmc = VBMC(target, None, *bounds, options=options, seed=task["seed"])
        record = vbmc.iteration_history.record_iteration

        def noting(values: Any, iteration: int) -> None:
            record(values, iteration)
            marks[iteration] = (target.evaluations, time.process_time() - begin)

        vbmc.iteration_history.record_iteration = noting
        final, _ = vbmc.optimize()
        overhead = time.process_time() - begin
        posteriors = [*vbmc.iteration_history["vp"], final]
        boosted = boosts(vbmc, task["boost"], marks)
    except Exception as caught:
        error = " ".join(f"{type(caught).__name__}: {caught.args[0] if caught.args else ''}".split())
        posteriors = list(vbmc.iteration_history["vp"] or []) if vbmc is not None else []
    posteriors += [vp for _, vp in boosted]
    if "at" in task:
        points = np.load(task["at"])["points"]
        found = [vp.pdf(points, orig_flag=True).ravel() for vp in posteriors]
    else:
        found = [vp.sample(task["draws"])[0] for vp in posteriors]
    np.savez(task["out"], posteriors=np.array(found))
    say(
        replies,
        done={
            "iterations": [marks[k] for k in sorted(marks)],
            "boosted": [mark for mark, _ in boosted],
            "overhead": overhead,
            "evaluations": target.evaluations,
            "failures": target.failures,
            "error": error,
            "version": metadata.version("pyvbmc"),
        },
    )


if __name__ == "__main__":
    _main()
