"""Planned experiments against the true model of the biofilm.

    python -m verification.validation.planning [gains] [advice] [unknown] [--truths 20] [--draws 1000] [--publish]

gains: expected information gains of twelve inflow rates and of their pairs against nested Monte Carlo with true runs.
advice: the widths after following the advice, against a second experiment at 50 mm²/s.
unknown: what a study of seven inputs is expected to leave unknown, against its posterior.

With ``--publish`` the tables go into docs/results/designs.md. All results are kept in output/planning.
"""

import json
import shutil
from argparse import Namespace
from collections.abc import Mapping, Sequence
from itertools import combinations_with_replacement
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float
from scipy.spatial.distance import cdist
from scipy.special import logsumexp
from verification.validation.compare_laws import STUDY
from verification.validation.tables import DOCS, OUTPUT, STUDIES, Table, arguments, as_text, show, table, write_study

import strandline as sl

SD = 0.0072
"""Standard deviation of each observed point along its normal, mm: that for which the noise variance of S3 is right."""
TRUTH = {"E": 400.0, "nu": 0.3}
RATES = (15.0, 25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 85.0, 95.0, 105.0, 115.0, 125.0)
OBSERVATIONS = 10
"""Observations of each draw."""
Points = Float[np.ndarray, "draw point 2"]
ADVISED_RATES = (25.0, 50.0, 75.0, 125.0, 150.0, 175.0, 200.0)
OTHER = 50.0
LOW, HIGH = np.array([100.0, -0.8]), np.array([800.0, 0.5])
HEADING = "combination | left, expected {.2f} | left, found {.2f} | cosine with the posterior's least known {.2f}"
PAGE = DOCS / "results" / "designs.md"


def observed(rate: float, truth: Mapping[str, float], random: np.random.Generator) -> Float[np.ndarray, "point 2"]:
    """Return the points of the interface at a rate with drawn errors, mm; the run may fail."""
    true = sl.Biofilm(mesh="coarse")({**truth, "V_in": rate}).interface
    return sl.PointErrors(SD).draw(true, random).points


def observed_study(
    folder: Path, seen: Mapping[float, Float[np.ndarray, "point 2"]], candidates: Mapping[str, Any] | None = None
) -> sl.Study:
    """Write a study with these observations by rate, and return it; several rates become conditions."""
    folder.mkdir(parents=True, exist_ok=True)
    content = yaml.safe_load(STUDY) | {"name": folder.name, "next": dict(candidates or {}), "seed": 1}
    content |= {"model": {"biofilm": {"mesh": "coarse"}}, "design": {"active": {"runs": 120}}}
    content |= {"discrepancy": {"normal_offset": {}}, "noise": {"sd": 1e3 * SD, "unit": "um"}}
    for rate, points in seen.items():
        np.savetxt(folder / f"{rate:g}.csv", points, delimiter=",", header="x,y", comments="")
    files = {rate: {"file": f"{rate:g}.csv", "unit": "mm"} for rate in seen}
    if len(seen) == 1:
        (rate,) = seen
        content |= {"fixed": {"V_in": rate}, "observation": files[rate]}
    else:
        content["model"]["biofilm"]["inflow_rates"] = {f"V{rate:g}": rate for rate in seen}
        content["observation"] = [{"condition": f"V{rate:g}", **file} for rate, file in files.items()]
    return sl.load_study(write_study(folder, content))


def _finished(study: sl.Study) -> sl.Posterior:
    return sl.run_study(study).calibration.posterior


def true_points(rate: float, draws: Float[np.ndarray, "draw dim"], ledger: Path, processes: int) -> Points:
    """Return the interface of the true model at each draw, NaN where its run fails; the ledger keeps the runs."""
    model, executor = sl.Biofilm(mesh="coarse"), sl.LocalProcesses(workers=processes)
    inputs = [{"E": float(young), "nu": float(poisson), "V_in": rate} for young, poisson in draws]
    with sl.Ledger.open(ledger, model=model) as opened:
        found = sl.run_campaign(model, inputs, ledger=opened, executor=executor)
    points = np.full((len(found), *next(one.interface.points.shape for one in found if one.ok)), np.nan)
    for place, one in zip(points, found, strict=True):
        place[:] = one.interface.points if one.ok else np.nan
    return points


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


def table_of_gains(output: Path, options: Namespace) -> tuple[Table, dict[str, object]]:
    """Return the gains of all rates and of the best pairs, and the largest differences.

    The true model is run at so many draws of the posterior; `output` keeps the study and these runs.
    """
    seen = {100.0: observed(100.0, TRUTH, np.random.default_rng(1))}
    study = observed_study(output / "gains", seen, {"V_in": list(RATES), "together": 2})
    posterior = _finished(study)
    found = sl.next_experiment(study, draws=4000).content
    chosen = np.unique(posterior.equally_weighted(7), axis=0)
    chosen = np.random.default_rng(7).permutation(chosen)[: options.draws]
    ledger = output / "true-runs.sqlite"
    signals = {rate: offsets(true_points(rate, chosen, ledger, options.processes)) for rate in RATES}
    failing = {rate: float(np.isnan(one).any(axis=1).mean()) for rate, one in signals.items()}
    ours = {tuple(s["V_in"] for s in one["settings"]): one for one in found["candidates"]}
    candidates = [*((rate,) for rate in RATES), *combinations_with_replacement(RATES, 2)]
    rows = [_row(rates, ours[rates], signals, failing) for rates in candidates]
    singles, pairs = ([row for row in rows if (row[0].count("+") > 0) is pair] for pair in (False, True))
    summary = {
        "largest difference, single": max(abs(row[1] - row[3]) for row in singles),
        "largest difference, pairs": max(abs(row[1] - row[3]) for row in pairs),
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


def table_of_advice(output: Path, options: Namespace) -> tuple[Table, dict[str, object]]:
    """Return the widths after each second experiment, and a summary; finished truths are kept."""
    random, rows = np.random.default_rng(2026), []
    for number in range(options.truths):
        kept, drawn = output / f"truth-{number}.json", _truth(random)
        if not kept.is_file():
            kept.write_text(json.dumps(_followed(output / f"truth-{number}", *drawn)), "utf-8")
        rows.append(json.loads(kept.read_text("utf-8")))
        print(rows[-1], flush=True)
    heading = (
        "E, Pa {.0f} | ν {.2f} | advised rate {.0f} | sd(ν) at 100 {.3f} | with 50 {.3f} | with the advised {.3f} "
        "| fall {.0%} | new runs {.0f}"
    )
    cells = [
        (*row["truth"], row["rate"], row["sd"], row["other"], row["advised"], _fall(row), row["new"]) for row in rows
    ]
    failed = sum(row["failed"] for row in rows)
    summary = {"median fall": median(map(_fall, rows)), "advised experiments that failed": failed}
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
    study = observed_study(folder / "first", {100.0: first}, {"V_in": list(ADVISED_RATES)})
    sd = float(_finished(study).sd[1])
    found = sl.next_experiment(study).content
    rate = found["candidates"][0]["settings"][0]["V_in"]
    advised = _second(folder / "advised", truth, first, rate, seed + 1)
    other = _second(folder / "other", truth, first, OTHER, seed + 2)
    widths = {"sd": sd, "advised": sd if advised is None else advised, "other": other, "failed": advised is None}
    return {"truth": [truth["E"], truth["nu"]], "rate": rate, **widths, "new": found["runs"]["new"]}


def _second(folder: Path, truth: dict[str, float], first: np.ndarray, rate: float, seed: int) -> float | None:
    """Return sd(ν) with a second experiment at a rate; None if the specimen folds."""
    try:
        second = observed(rate, truth, np.random.default_rng(seed))
    except sl.ForwardModelError:
        return None
    return float(_finished(observed_study(folder, {100.0: first, rate: second})).sd[1])


def table_of_unknown(output: Path, options: Namespace) -> tuple[Table, dict[str, object]]:
    """Return the combinations of the inputs with what is expected and what is found of the prior's width."""
    folder = output / "unknown"
    if not folder.is_dir():
        folder.mkdir(parents=True)
        shutil.copy2(STUDIES / "biofilm-parts-active" / "study.yaml", folder)
    study = sl.load_study(folder)
    before = sl.next_experiment(study, source="prior").content
    posterior = _finished(study)
    scaled, weights = scaled_draws(study, posterior), posterior.weights
    covariance = np.cov(scaled.T, aweights=weights, ddof=0)
    worst = np.linalg.eigh(covariance)[1][:, -1]
    rows, inside = [], 0.0
    for one in before["directions"]:
        v = np.array([one["weights"][name] for name in study.space.names])
        rows.append((one["in_words"], one["left"], float(np.sqrt(v @ covariance @ v)), abs(float(v @ worst))))
        inside += float(v @ worst) ** 2 if one["left"] > 0.85 else 0.0
    summary = {
        "posterior's least known": dict(zip(study.space.names, np.round(worst, 2).tolist(), strict=True)),
        "cosine with all combinations said to be unknown": float(np.sqrt(inside)),
    }
    return table("planning-unknown", "Unknown", HEADING, rows), summary


def scaled_draws(study: sl.Study, posterior: sl.Posterior) -> np.ndarray:
    """Return the draws in prior standard deviations, of positive inputs by their logarithms."""
    p = (np.arange(1000) + 0.5) / 1000
    prior = study.space.prior_quantiles(np.repeat(p[:, None], study.space.dim, axis=1))
    positive = study.space.low >= 0
    both = [np.where(positive, np.log(np.where(positive, x, 1.0)), x) for x in (prior, posterior.draws)]
    return np.asarray(both[1] / both[0].std(axis=0))


PARTS = {"gains": table_of_gains, "advice": table_of_advice, "unknown": table_of_unknown}

if __name__ == "__main__":
    options = arguments(__doc__, words=PARTS, truths=20, draws=1000, processes=2, publish=False)
    (OUTPUT / "planning").mkdir(parents=True, exist_ok=True)
    for part in options.words or PARTS:
        found, summary = PARTS[part](OUTPUT / "planning", options)
        show([found], page=PAGE if options.publish else None)
        print(as_text(summary), flush=True)
