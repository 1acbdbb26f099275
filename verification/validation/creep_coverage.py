"""Does the posterior of a creep test contain the truth? Data sets of the example `creep`, with truths from its prior.

One design of Sobol runs serves all of them; with --active, each analysis makes further runs until it is certified. A
90 % region is the ellipsoid, in E, ν, the ratio and the logarithm of the relaxation time, that holds 90 % of the draws.

    python -m verification.validation.creep_coverage [--truths 20] [--shared 128] [--active] [--publish]
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.linalg import inv
from scipy.spatial.distance import cdist
from verification.validation.tables import DOCS, EXAMPLES, OUTPUT, arguments, show, table, write_study
from verification.validation.what_if import new_runs

import strandline as sl
from strandline.posterior import Weighted

PAGE = DOCS / "how-to" / "creep.md"
NAMES = ("E", "nu", "ratio", "tau")
RATE = 100.0


def _write(folder: Path, **changes: Any) -> sl.Study:
    content = yaml.safe_load((EXAMPLES / "creep" / "study.yaml").read_text("utf-8"))
    return sl.load_study(write_study(folder, content | {"name": folder.name, **changes}))


def analysed(folder: Path, truth: Mapping[str, float], seed: int, shared: sl.Study, design: Any) -> dict[str, Any]:
    """Return how one data set ended."""
    observation = {"synthetic": {**truth, "V_in": RATE}, "noise": {"sd": 0.003, "seed": seed}}
    study = _write(folder, observation=observation, reuse=[f"../{shared.folder.name}"], design=design)
    outcome = sl.run_study(study)
    posterior, certificate = outcome.calibration.posterior, outcome.summary.get("certificate") or {}
    draws, exact = _scaled(posterior.draws), _scaled(np.array([[truth[name] for name in NAMES]]))
    weights = posterior.weights
    scaled = Weighted(draws, weights)
    far, of_truth = (cdist(x, scaled.mean[None], "mahalanobis", VI=inv(scaled.covariance)) for x in (draws, exact))
    marginal = zip(*posterior.quantiles((0.05, 0.95)), (truth[name] for name in NAMES), strict=True)
    return {
        "mean": posterior.mean.tolist(),
        "sd": posterior.sd.tolist(),
        "inside": bool(weights[far[:, 0] <= of_truth[0, 0]].sum() <= 0.9),
        "marginal": [bool(low <= x <= high) for low, high, x in marginal],
        "new": new_runs(shared, outcome.calibration),
        "verdict": certificate.get("verdict", "not checked"),
    }


def _scaled(x: np.ndarray) -> np.ndarray:
    """Return inputs with the logarithm of the relaxation time in its place."""
    return np.column_stack([x[:, :3], np.log(x[:, 3])])


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


def _main() -> None:
    options = arguments(__doc__, truths=20, shared=128, active=False, folder=OUTPUT / "creep", publish=False)
    rows, sobol = [], {"sobol": {"runs": options.shared, "scramble": 1}}
    design = {"active": {"runs": 100}} if options.active else sobol
    shared = _write(options.folder / "shared", design=sobol)
    with sl.Ledger.open(shared.ledger_path, model=shared.runs.identity, description="shared") as ledger:
        sl.run_campaign(shared.model, shared.runs.design, ledger=ledger, executor=shared.executor)
    for number, truth in enumerate(truths(_write(options.folder / "truths"), options.truths)):
        found = analysed(options.folder / f"set-{number}", truth, number, shared, design)
        print(found, flush=True)
        moments = zip(NAMES, found["mean"], found["sd"], strict=True)
        cells = [f"{m:.3g} ± {s:.2g} ({truth[n]:.3g})" for n, m, s in moments]
        inside = "yes" if found["inside"] else "no"
        rows.append((*cells, inside, sum(found["marginal"]), found["new"], found["verdict"]))
    heading = "E, Pa (truth) | ν | ratio | τ, s | in the 90 % region | of 4 intervals {d} | new runs {d} | certificate"
    show([table("creep_coverage", "Creep tests", heading, rows)], page=PAGE if options.publish else None)
    inside, intervals = sum(row[4] == "yes" for row in rows), sum(row[5] for row in rows)
    print(f"inside: {inside} of {len(rows)}; intervals: {intervals} of {4 * len(rows)}; shared runs: {options.shared}")


if __name__ == "__main__":
    _main()
