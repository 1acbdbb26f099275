"""Expected information gains against nested Monte Carlo with the true model, written independently of the product."""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import combinations_with_replacement
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist
from scipy.special import logsumexp
from verification.validation.planning.studies import SD, TRUTH, finished, observed, write_study
from verification.validation.tables import Table, table

import strandline as sl

RATES = (15.0, 25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 85.0, 95.0, 105.0, 115.0, 125.0)
OBSERVATIONS = 10
"""Observations of each draw."""
Points = Float[np.ndarray, "draw point 2"]


def true_points(rate: float, draws: Float[np.ndarray, "draw dim"], processes: int) -> Points:
    """Return the interface of the true model at each draw; NaN where its run fails."""
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        found = [*pool.map(_run, [(rate, *draw) for draw in draws], chunksize=25)]
    shape = next(one for one in found if one is not None).shape
    return np.array([np.full(shape, np.nan) if one is None else one for one in found])


def _run(inputs: tuple[float, float, float]) -> Float[np.ndarray, "point 2"] | None:
    rate, young, poisson = inputs
    try:
        return sl.Biofilm(mesh="coarse")({"E": young, "nu": poisson, "V_in": rate}).interface.points
    except sl.ForwardModelError:
        return None


def offsets(points: Points) -> Float[np.ndarray, "draw point"]:
    """Return displacements along the normals of the mean interface, in standard deviations of the errors."""
    mean = np.nanmean(points, axis=0)
    tangent = np.gradient(mean, axis=0)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1)[:, None]
    return np.asarray(np.einsum("dpx,px->dp", points - mean, normal) / SD)


def nested(signals: Float[np.ndarray, "draw signal"]) -> tuple[float, float]:
    """Return the gain and its standard error, each draw in turn the truth and all others the prior, in nats.

    Each truth is observed several times. The average log p(s) of a finite number of draws is biased; the bias is
    extrapolated from halves of them.
    """
    found = np.zeros((OBSERVATIONS, len(signals)))
    for k in range(OBSERVATIONS):
        noise = np.random.default_rng(k).standard_normal(signals.shape)
        halves = np.zeros(len(signals))
        for half in (np.arange(0, len(signals), 2), np.arange(1, len(signals), 2)):
            halves[half] = _log_ratios(signals[half], noise[half])
        found[k] = 2 * _log_ratios(signals, noise) - halves
    gains = found.mean(axis=0)
    return float(gains.mean()), float(gains.std() / np.sqrt(len(gains)))


def _log_ratios(signals: Float[np.ndarray, "draw signal"], noise: Float[np.ndarray, "draw signal"]) -> np.ndarray:
    """Return log p(s | x) - log p(s) of the observation of each draw."""
    squares = -0.5 * cdist(signals + noise, signals, "sqeuclidean")
    fits = np.diag(squares).copy()
    np.fill_diagonal(squares, -np.inf)
    return np.asarray(fits - (logsumexp(squares, axis=1) - np.log(len(signals) - 1)))


def _true_runs(kept: Path, draws: Float[np.ndarray, "draw dim"], processes: int) -> dict[float, Points]:
    """Return the true interfaces by rate, which are kept for a later call."""
    if not kept.is_file() or not np.array_equal(np.load(kept)["draws"], draws):
        np.savez(kept, draws=draws, points=np.array([true_points(rate, draws, processes) for rate in RATES]))
    return dict(zip(RATES, np.load(kept)["points"], strict=True))


def table_of_gains(output: Path, draws: int, processes: int) -> tuple[Table, dict[str, object]]:
    """Return the gains of all rates and of the best pairs, and a summary.

    Args:
        output: Folder for the study and the true runs.
        draws: Number of draws of the posterior at which the true model is run.
        processes: Number of processes for these runs.
    """
    seen = {100.0: observed(100.0, TRUTH, np.random.default_rng(1))}
    study = write_study(output / "gains", seen, {"V_in": list(RATES), "together": 2})
    posterior = finished(study)
    found = sl.next_experiment(study, draws=4000).content
    chosen = np.unique(posterior.equally_weighted(7), axis=0)
    chosen = np.random.default_rng(7).permutation(chosen)[:draws]
    points = _true_runs(output / "true-runs.npz", chosen, processes)
    signals = {rate: offsets(one) for rate, one in points.items()}
    failing = {rate: float(np.isnan(one).any(axis=1).mean()) for rate, one in signals.items()}
    ours = {tuple(s["V_in"] for s in one["settings"]): one for one in found["candidates"]}
    candidates = [*((rate,) for rate in RATES), *combinations_with_replacement(RATES, 2)]
    rows = [_row(rates, ours[rates], signals, failing) for rates in candidates]
    singles, pairs = ([row for row in rows if (row[0].count("+") > 0) is pair] for pair in (False, True))
    summary = {
        "largest difference, single": max(abs(row[1] - row[3]) for row in singles),
        "largest difference, pairs": max(abs(row[1] - row[3]) for row in pairs),
        "top three, product": [_top(some, 1) for some in (singles, pairs)],
        "top three, true": [_top(some, 3) for some in (singles, pairs)],
        "new runs": found["runs"]["new"],
        "seconds": found["seconds"],
        "failures, predicted and true": {r: (ours[(r,)]["failing"], failing[r]) for r in RATES},
    }
    best = sorted(pairs, key=lambda row: -row[3])[:6]
    heading = (
        "rates, mm²/s | gain {.3f} | error {.3f} | gain, true model {.3f} | error {.3f} | runs that fail {.1%} "
        "| of the true model {.1%}"
    )
    return table("planning-gains", "Gains", heading, (*singles, *best)), summary


def _row(rates: Sequence[float], ours: dict, signals: dict, failing: dict) -> tuple:
    both = np.hstack([signals[rate] for rate in rates])
    gain, error = nested(both[~np.isnan(both).any(axis=1)])
    fails = 1 - float(np.prod([1 - failing[rate] for rate in rates]))
    name = " + ".join(f"{rate:g}" for rate in rates)
    return name, ours["gain"], ours["error"], gain, error, ours["failing"], fails


def _top(rows: Sequence[tuple], column: int) -> list[str]:
    return [row[0] for row in sorted(rows, key=lambda row: -row[column])[:3]]
