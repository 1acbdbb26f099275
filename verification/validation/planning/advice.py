"""How much the advice helps: a second experiment at the advised rate, against one at 50 mm²/s."""

import json
from pathlib import Path
from statistics import median

import numpy as np
from verification.validation.planning.studies import finished, observed, write_study
from verification.validation.tables import Table, table

import strandline as sl

RATES = (25.0, 50.0, 75.0, 125.0, 150.0, 175.0, 200.0)
OTHER = 50.0
LOW, HIGH = np.array([100.0, -0.8]), np.array([800.0, 0.5])


def table_of_advice(output: Path, truths: int) -> tuple[Table, dict[str, object]]:
    """Return the widths after each second experiment, and a summary; finished truths are kept."""
    kept = output / "advice-rows.json"
    rows = json.loads(kept.read_text()) if kept.is_file() else []
    random = np.random.default_rng(2026)
    for number in range(truths):
        truth, first, seed = _truth(random)
        if number < len(rows):
            continue
        rows.append(_followed(output / f"truth-{number}", truth, first, seed))
        kept.write_text(json.dumps(rows))
        print(rows[-1], flush=True)
    heading = (
        "E, Pa {.0f} | ν {.2f} | advised rate {.0f} | sd(ν) at 100 {.3f} | with 50 {.3f} | with the advised {.3f} "
        "| fall {.0%} | new runs {.0f}"
    )
    cells = [
        (*row["truth"], row["rate"], row["sd"], row["other"], row["advised"], _fall(row), row["new"]) for row in rows
    ]
    falls = [_fall(row) for row in rows]
    summary = {
        "truths": len(rows),
        "median fall": median(falls),
        "advised experiments that failed": sum(row["failed"] for row in rows),
        "expected over found sd, median": median(row["expected"] / row["advised"] for row in rows if not row["failed"]),
    }
    return table("planning-advice", "Following the advice", heading, cells), summary


def _fall(row: dict) -> float:
    return float(1 - row["advised"] / row["other"])


def _truth(random: np.random.Generator) -> tuple[dict[str, float], np.ndarray, int]:
    """Return a draw of the prior at which the run at 100 succeeds, with its observation and a seed for others."""
    while True:
        x = LOW + (HIGH - LOW) * random.random(2)
        truth, seed = dict(zip(("E", "nu"), x.tolist(), strict=True)), int(random.integers(2**31))
        try:
            return truth, observed(100.0, truth, np.random.default_rng(seed)), seed
        except sl.ForwardModelError:
            continue


def _followed(folder: Path, truth: dict[str, float], first: np.ndarray, seed: int) -> dict[str, object]:
    """Return the widths of ν after the first experiment, and with either second one."""
    study = write_study(folder / "first", {100.0: first}, {"V_in": list(RATES)})
    sd = float(finished(study).sd[1])
    found = sl.next_experiment(study).content
    best = found["candidates"][0]
    rate = best["settings"][0]["V_in"]
    advised = _second(folder / "advised", truth, first, rate, seed + 1)
    other = _second(folder / "other", truth, first, OTHER, seed + 2)
    return {
        "truth": [truth["E"], truth["nu"]],
        "rate": rate,
        "sd": sd,
        "expected": best["sd"]["nu"],
        "failing": best["failing"],
        "advised": sd if advised is None else advised,
        "other": other,
        "failed": advised is None,
        "new": found["runs"]["new"],
    }


def _second(folder: Path, truth: dict[str, float], first: np.ndarray, rate: float, seed: int) -> float | None:
    """Return sd(ν) with a second experiment at a rate; None if the specimen folds."""
    try:
        second = observed(rate, truth, np.random.default_rng(seed))
    except sl.ForwardModelError:
        return None
    study = write_study(folder, {100.0: first, rate: second})
    return float(finished(study).sd[1])
