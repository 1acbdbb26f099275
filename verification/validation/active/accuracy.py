"""Runs until the posterior is right: S3 and S5 against quadrature of the true model, S6 by importance weights."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from verification.reproduction.grid_posterior import posterior_on_grid, product_grid, total_variation
from verification.validation.active.cases import Case, case, truth_of
from verification.validation.active.grow import Grown, delivered, grow

from strandline.posterior import reweight, subset

PANELS = (24, 12, 8)
DRAWS = 100
"""Draws of the posterior of S6 at which the true model checks it: enough to see a shift of 0.1 standard deviations."""


def s3(
    quadrature: str, *, sensitivities: bool, seed: int, most: int, criterion: str, share: float = 0.0
) -> dict[str, Any]:
    """Return the total variation to the true posterior over the (E, nu) plane; a `share` of runs fails at random."""
    one = case("S3", quadrature)
    truth, grid = truth_of(one), product_grid(one.space, panels=PANELS, rate=100.0)
    true = posterior_on_grid(truth.field, one.space, grid)
    points = []
    options = {"sensitivities": sensitivities, "criterion": criterion, "seed": seed}
    for grown in grow(one, batch=2, most=most, spoil=failing(share, seed), **options):
        known = grown.state.knowledge
        found = posterior_on_grid(lambda x, known=known: known.expected(x[:, :2]), one.space, grid)
        points.append(
            _common(grown)
            | {
                "total_variation": total_variation(found, true),
                "mean_error": float(np.abs((found.mean - true.mean) / true.sd).max()),
                "sd_error": float(np.abs(found.sd / true.sd - 1).max()),
            }
        )
    return {"study": "S3", "quadrature": quadrature, **options, "points": points, "share": share}


def s5(quadrature: str, *, sensitivities: bool, seed: int, most: int, criterion: str) -> dict[str, Any]:
    """Return the errors of mean and standard deviation of (E, nu) with the inflow integrated out: the joint reading."""
    one = case("S5", quadrature)
    truth = truth_of(one).posterior
    calibrated = [one.space.names.index(name) for name in ("E", "nu")]
    points, options = [], {"sensitivities": sensitivities, "criterion": criterion, "seed": seed}
    for grown in grow(one, batch=4, most=most, **options):
        found = delivered(one, grown.state.knowledge, seed)
        mean, sd = found.mean[calibrated], found.sd[calibrated]
        points.append(
            _common(grown)
            | {
                "mean_error": float(np.abs((mean - truth.mean) / truth.sd).max()),
                "sd_error": float(np.abs(sd / truth.sd - 1).max()),
            }
        )
    return {"study": "S5", "quadrature": quadrature, **options, "points": points, "share": 0.0}


def s6(
    quadrature: str, *, sensitivities: bool, seed: int, most: int, first: int, batch: int, criterion: str
) -> dict[str, Any]:
    """Return the importance weights by the true model at draws of the posterior, from `first` runs on."""
    one = case("S6", quadrature)
    points, options = [], {"sensitivities": sensitivities, "criterion": criterion, "seed": seed}
    for grown in grow(one, batch=batch, most=most, **options):
        point = _common(grown)
        if grown.runs >= first:
            point |= checked(one, grown, seed)
        points.append(point)
        if point.get("effective", 0.0) >= 0.8 and point["k_hat"] < 0.5 and point["shift"] < 0.1:
            break
    return {"study": "S6", "quadrature": quadrature, **options, "points": points, "share": 0.0}


def checked(one: Case, grown: Grown, seed: int) -> dict[str, Any]:
    """Run the true model at draws of the posterior; these runs only check it and do not train the surrogate."""
    state = grown.state
    chosen = subset(np.exp(state.log_weights), DRAWS, seed)
    records = [one.run(x, False) for x in state.positions[chosen]]
    good = np.array([record.ok for record in records])
    true = np.array([one.log_likelihood(record) for record in records if record.ok])
    found = reweight(state.positions[chosen][good], true - state.log_expected[chosen][good])
    return {
        "k_hat": found.smoothed.k_hat,
        "effective": found.smoothed.ess / int(good.sum()),
        "shift": float(np.abs(found.shift).max()),
        "shift_error": float(found.shift_error[np.argmax(np.abs(found.shift))]),
        "sd_error": float(np.abs(found.sd_ratio - 1).max()),
        "failed_draws": int((~good).sum()),
        "log_likelihood_rms": float(np.std(true - state.log_expected[chosen][good])),
    }


def failing(share: float, seed: int) -> Any:
    """Return a function that makes a share of the successful runs fail, whatever their inputs."""
    rng = np.random.default_rng([seed, 77])

    def spoil(record: Any) -> Any:
        fails = rng.random() < share
        gone = {"state": "failed", "interfaces": {}, "sensitivities": {}, "failure_kind": "at_random"}
        return replace(record, **gone) if record.ok and fails else record

    return spoil


def _common(grown: Grown) -> dict[str, Any]:
    surrogate = grown.state.knowledge.surrogate
    errors: Float[np.ndarray, " particle"] = surrogate.predicted_error(grown.state.positions)
    return {
        "runs": grown.runs,
        "failed": grown.failed,
        "seconds": grown.seconds,
        "error_um": 1e3 * float(np.median(errors)),
        "left_out_um": 1e3 * float(np.median(surrogate.left_out_error())),
        "modes": len(surrogate.processes),
    }
