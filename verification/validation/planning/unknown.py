"""What seven inputs are expected to leave unknown before any data, against the posterior of the finished study."""

import shutil
from pathlib import Path

import numpy as np
from verification.validation.tables import STUDIES, Table, table

import strandline as sl

HEADING = "combination | left, expected {.2f} | left, found {.2f} | cosine with the posterior's least known {.2f}"


def table_of_unknown(output: Path) -> tuple[Table, dict[str, object]]:
    """Return the combinations of the inputs with what is expected and what is found of the prior's width."""
    folder = output / "unknown"
    if not folder.is_dir():
        folder.mkdir(parents=True)
        shutil.copy2(STUDIES / "biofilm-parts-active" / "study.yaml", folder)
    study = sl.load_study(folder)
    before = sl.next_experiment(study, source="prior").content
    posterior = sl.run_study(study).calibration.posterior
    scaled, weights = scaled_draws(study, posterior), posterior.weights
    covariance = np.cov(scaled.T, aweights=weights, ddof=0)
    values, vectors = np.linalg.eigh(covariance)
    worst = vectors[:, -1]
    rows, inside = [], 0.0
    for one in before["directions"]:
        v = np.array([one["weights"][name] for name in study.space.names])
        rows.append((one["in_words"], one["left"], float(np.sqrt(v @ covariance @ v)), abs(float(v @ worst))))
        inside += float(v @ worst) ** 2 if one["left"] > 0.85 else 0.0
    summary = {
        "posterior's least known": dict(zip(study.space.names, np.round(worst, 2).tolist(), strict=True)),
        "its share of the prior's width": float(np.sqrt(values[-1])),
        "cosine with all combinations said to be unknown": float(np.sqrt(inside)),
        "runs before any data": before["runs"],
    }
    return table("planning-unknown", "Unknown", HEADING, rows), summary


def scaled_draws(study: sl.Study, posterior: sl.Posterior) -> np.ndarray:
    """Return the draws in prior standard deviations, of positive inputs by their logarithms."""
    p = (np.arange(1000) + 0.5) / 1000
    prior = study.space.prior_quantiles(np.repeat(p[:, None], study.space.dim, axis=1))
    positive = study.space.low >= 0
    both = [np.where(positive, np.log(np.where(positive, x, 1.0)), x) for x in (prior, posterior.draws)]
    return np.asarray(both[1] / both[0].std(axis=0))
