"""Does the posterior of a creep test contain the truth? Data sets of the example `creep`, with truths from its prior.

One design of Sobol runs serves all of them; with --active, each analysis makes further runs until it is certified. A
90 % region is the ellipsoid, in E, ν, the ratio and the logarithm of the relaxation time, that holds 90 % of the draws.

    python -m verification.validation.creep_coverage [--truths 20] [--shared 128] [--active] [--publish]
"""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from verification.validation.tables import Table, put_into_page

import strandline as sl

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "creep.md"
NAMES = ("E", "nu", "ratio", "tau")
RATE = 100.0


def write(folder: Path, **changes: Any) -> sl.Study:
    """Write the example with changes into a folder, and return it."""
    content = yaml.safe_load((ROOT / "examples" / "creep" / "study.yaml").read_text("utf-8"))
    content |= {"name": folder.name, **changes}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "study.yaml").write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True), "utf-8")
    return sl.load_study(folder)


def shared_runs(folder: Path, number: int) -> None:
    """Make the runs that all data sets share; those of an earlier call are kept."""
    study = write(folder, design={"sobol": {"runs": number, "scramble": 1}})
    with sl.Ledger.open(study.ledger_path, model=study.runs.identity, description="shared") as ledger:
        sl.run_campaign(study.model, study.runs.design, ledger=ledger, executor=study.executor)


def analysed(folder: Path, truth: Mapping[str, float], seed: int, shared: Path, design: Any) -> dict[str, Any]:
    """Return how one data set ended; kept in the folder for a later call."""
    kept = folder / "outcome.json"
    if kept.is_file():
        found: dict[str, Any] = json.loads(kept.read_text("utf-8"))
        return found
    observation = {"synthetic": {**truth, "V_in": RATE}, "noise": {"sd": 0.003, "seed": seed}}
    study = write(folder, observation=observation, reuse=[f"../{shared.name}"], design=design)
    outcome = sl.run_study(study)
    posterior, certificate = outcome.calibration.posterior, outcome.summary.get("certificate") or {}
    draws, exact = _scaled(posterior.draws), _scaled(np.array([[truth[name] for name in NAMES]]))
    weights = np.exp(posterior.log_weights - posterior.log_weights.max())
    weights /= weights.sum()
    mean = weights @ draws
    precision = np.linalg.inv((draws - mean).T @ (weights[:, None] * (draws - mean)))
    far, of_truth = (np.einsum("ij,jk,ik->i", x - mean, precision, x - mean) for x in (draws, exact))
    lower, upper = (_quantile(draws, weights, q) for q in (0.05, 0.95))
    found = {
        "truth": dict(truth),
        "mean": posterior.mean.tolist(),
        "sd": posterior.sd.tolist(),
        "inside": bool(weights[far <= of_truth[0]].sum() <= 0.9),
        "marginal": [bool(a <= x <= b) for a, x, b in zip(lower, exact[0], upper, strict=True)],
        "new": outcome.summary["runs"]["new"],
        "verdict": certificate.get("verdict", "not checked"),
    }
    kept.write_text(json.dumps(found), "utf-8")
    return found


def _scaled(x: np.ndarray) -> np.ndarray:
    """Return inputs with the logarithm of the relaxation time in its place."""
    return np.column_stack([x[:, :3], np.log(x[:, 3])])


def _quantile(x: np.ndarray, weights: np.ndarray, q: float) -> np.ndarray:
    order = np.argsort(x, axis=0)
    below = np.cumsum(weights[order], axis=0)
    return np.array([x[order[np.searchsorted(below[:, k], q), k], k] for k in range(x.shape[1])])


def truths(study: sl.Study, number: int) -> list[dict[str, float]]:
    """Return draws of the prior at which the model gives a result."""
    random, found = np.random.default_rng(2026), []
    while len(found) < number:
        x = study.space.prior_quantiles(random.random((1, study.space.dim)))[0]
        inputs = study.space.as_mapping(x)
        try:
            study.model({**study.fixed, **inputs}, Path())
        except sl.ForwardModelError:
            continue
        found.append({name: float(value) for name, value in inputs.items()})
    return found


def main() -> None:
    """Analyse the data sets and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--truths", type=int, default=20)
    parser.add_argument("--shared", type=int, default=128, help="Sobol runs that all data sets share")
    parser.add_argument("--active", action="store_true", help="check each posterior by further runs")
    parser.add_argument("--folder", type=Path, default=Path(__file__).parents[1] / "output" / "creep")
    parser.add_argument("--publish", action="store_true", help="put the table into the page")
    options = parser.parse_args()
    shared, rows = options.folder / "shared", []
    design = {"active": {"runs": 100}} if options.active else {"sobol": {"runs": options.shared, "scramble": 1}}
    shared_runs(shared, options.shared)
    for number, truth in enumerate(truths(write(options.folder / "truths"), options.truths)):
        found = analysed(options.folder / f"set-{number}", truth, number, shared, design)
        print(found, flush=True)
        cells = [
            f"{m:.3g} ± {s:.2g} ({truth[n]:.3g})" for n, m, s in zip(NAMES, found["mean"], found["sd"], strict=True)
        ]
        rows.append(
            (*cells, "yes" if found["inside"] else "no", sum(found["marginal"]), found["new"], found["verdict"])
        )
    columns = ("E, Pa (truth)", "ν", "ratio", "τ, s", "in the 90 % region", "of 4 intervals", "new runs", "certificate")
    table = Table("creep_coverage", "Creep tests", columns, ("s", "s", "s", "s", "s", "d", "d", "s"), tuple(rows))
    print(table.markdown())
    inside, intervals = sum(row[4] == "yes" for row in rows), sum(row[5] for row in rows)
    print(f"inside: {inside} of {len(rows)}; intervals: {intervals} of {4 * len(rows)}; shared runs: {options.shared}")
    if options.publish:
        PAGE.write_text(put_into_page(PAGE.read_text("utf-8"), [table]), "utf-8")


if __name__ == "__main__":
    main()
