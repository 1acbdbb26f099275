"""The entries of summary.json on a surrogate of the field: the surrogate, its certificate, and a comparison."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.calibration import Calibration
from strandline.design import BatchCheck, FidelityReport, FieldOutcome, Step
from strandline.interface import Observation, UnknownErrors, steady_lengths
from strandline.likelihood import NoisePosterior
from strandline.studies.load.provenance import named

TO_MICROMETRES = 1e3
LEVELS = {"q05": 0.05, "median": 0.5, "q95": 0.95}
"""Quantiles of inferred noise and of an error of the model."""


def field_surrogate(calibration: Calibration, found: FieldOutcome) -> dict[str, Any]:
    """Return a description of the surrogate, its errors along the interface, and their effect on the posterior."""
    surrogate, names = found.knowledge.surrogate, calibration.problem.space.names
    at_draws = surrogate.predicted_error(calibration.posterior.draws)
    return {
        "kind": "field",
        "n_train": surrogate.runs,
        "modes": len(surrogate.processes),
        "warps": dict(zip(names, surrogate.warping.names, strict=True)),
        "gradients": surrogate.gradients,
        "common_points": ", ".join(surrogate.ways),
        "registration_error_um": TO_MICROMETRES * surrogate.registration_error,
        "remainder_um": TO_MICROMETRES * surrogate.modes.remainder,
        "left_out_error_um": _quantiles(surrogate.left_out_error(), None),
        "predicted_error_um": _quantiles(at_draws, calibration.posterior.weights),
        "scatter": {
            "rms_um": TO_MICROMETRES * found.scatter.rms,
            "share_of_noise": found.scatter.share,
            "log_likelihood_sd": found.scatter.sd,
        },
        "variance_effect": {
            "shift": _by_name(names, found.effect.shift),
            "sd_ratio": _by_name(names, found.effect.sd_ratio),
            "effective": found.effect.effective,
        },
        "feasible_mass": found.feasible,
    }


def inferred_noise(calibration: Calibration) -> dict[str, Any]:
    """Return the posterior of unknown noise: sd and correlation length, µm, and the error of the model if allowed."""
    inferred = None if calibration.field is None else calibration.field.knowledge.likelihood.inferred
    if inferred is None:
        return {}
    found = inferred.posterior
    quantiles = found.quantiles(list(LEVELS.values()))
    of: dict[str, Any] = {
        f"{name}_um": dict(zip(LEVELS, (TO_MICROMETRES * value for value in values), strict=True))
        for name, values in quantiles.items()
    }
    noises = [seen.noise for seen in calibration.problem.observations]
    of["stated"] = all(isinstance(one, UnknownErrors) and one.stated for one in noises)
    of["prior"] = _prior(next(one for one in noises if isinstance(one, UnknownErrors)))
    if len(found.causes) > 1:
        of["model_error"] = {
            "probability": found.probability_of_model_error,
            "amplitude_um": TO_MICROMETRES * found.model_error,
            "spread": found.spread,
            **_offset(found, calibration.problem.observations),
        }
    without = None if calibration.field is None else calibration.field.without_error
    if without is not None:
        of["without_model_error"] = {
            name: {"mean": float(without["mean"][i]), "sd": float(without["sd"][i])}
            for i, name in enumerate(calibration.problem.space.names)
        }
    return {"inferred_noise": of}


def _prior(noise: UnknownErrors) -> dict[str, list[float] | float | None]:
    """Return what the study states of sd and correlation length, µm: a range, a number, or None if it is unknown."""

    def stated(one: tuple[float, float] | float | None) -> list[float] | float | None:
        if isinstance(one, tuple):
            return [float(f"{TO_MICROMETRES * end:.12g}") for end in one]
        return None if one is None else float(f"{TO_MICROMETRES * one:.12g}")

    return {"sd_um": stated(noise.sd), "length_um": stated(noise.length)}


def _offset(found: NoisePosterior, observations: Sequence[Observation]) -> dict[str, Any]:
    """Return quantiles of amplitude and length of the model's offset, µm, if it errs; None if no offset was allowed."""
    quantiles = found.quantiles_of_offset(list(LEVELS.values()))
    whole = float(np.mean([steady_lengths(seen.interface).sum() for seen in observations]))
    return {
        key: None if quantiles is None else dict(zip(LEVELS, (unit * one for one in quantiles[name]), strict=True))
        for key, name, unit in (
            ("amplitude_quantiles_um", "amplitude", TO_MICROMETRES),
            ("length_um", "share", TO_MICROMETRES * whole),
        )
    }


def certificate(calibration: Calibration) -> dict[str, Any] | None:
    """Return the certificate of the posterior of an active design; None for a fixed design."""
    found = calibration.field
    if found is None or found.certificate is None:
        return None
    names, given = calibration.problem.space.names, found.certificate
    checked = None if given.checked is None else given.checked.check
    return {
        "converged": given.converged,
        "verdict": "converged" if given.converged else "not converged: " + "; ".join(given.reasons),
        "scattered": given.scattered,
        "runs": len(calibration.all_runs),
        "batches": [{"kind": batch.kind, "runs": len(batch.points)} for batch in given.batches],
        "check": None if checked is None else _check(checked, given.checked, names),
        "error_um": TO_MICROMETRES * given.steps[-1].error if given.steps else None,
        "feasible_mass": found.feasible,
        "region_found": given.found,
        "statement": given.statement,
        "fidelities": None if given.fidelities is None else _fidelities(given.fidelities),
        "history": [_step(step, names) for step in given.steps],
    }


def _fidelities(found: FidelityReport) -> dict[str, Any]:
    return {
        "cost": found.cost,
        "cheaper_runs": found.cheaper,
        "model_runs": found.model,
        "equivalents": found.equivalents,
        "pairs": found.pairs,
        "error_um": None if found.error is None else TO_MICROMETRES * found.error,
        "hidden_um": TO_MICROMETRES * found.hidden,
        **named(found, "dropped", "statement"),
    }


def comparison(calibration: Calibration) -> dict[str, Any] | None:
    """Return the posterior from the published study's surrogate of the same runs; None if there is none."""
    found = calibration.field
    if found is None or found.compared is None:
        return None
    posterior, other = calibration.posterior, found.compared
    return {
        "inputs": {
            name: {
                "mean": float(other["mean"][i]),
                "sd": float(other["sd"][i]),
                "shift_sd": float((other["mean"][i] - posterior.mean[i]) / posterior.sd[i]),
                "sd_ratio": float(other["sd"][i] / posterior.sd[i]),
            }
            for i, name in enumerate(posterior.space.names)
        }
    }


def _check(found: BatchCheck, step: Step | None, names: tuple[str, ...]) -> dict[str, Any]:
    weights, moments = found.reweighting, ("shift", "shift_error", "sd_ratio")
    of: dict[str, Any] = dict.fromkeys(("k_hat", "effective", *moments))
    if weights is not None:
        k_hat, each = weights.smoothed.k_hat, weights.smoothed.log_weights
        of = {"k_hat": k_hat if np.isfinite(k_hat) else None, "effective": weights.smoothed.ess / len(each)}
        of |= {name: _by_name(names, getattr(weights, name)) for name in moments}
    return {
        "by": "left-out runs" if step is not None and step.kind == "given" else "runs at draws of the posterior",
        **named(found, "passed", "draws", "failed", "left_out", "early", "given_up"),
        "reasons": list(found.reasons),
        **of,
    }


def _step(step: Step, names: tuple[str, ...]) -> dict[str, Any]:
    return {
        **named(step, "runs", "ok", "kind"),
        "mean": _by_name(names, step.mean),
        "sd": _by_name(names, step.sd),
        "error_um": TO_MICROMETRES * step.error,
        "since": step.since,
        "change": None if step.moved is None else step.moved.shift,
        "change_sd": None if step.moved is None else step.moved.width,
        "effective": None if step.moved is None else step.moved.effective,
    }


def _by_name(names: tuple[str, ...], values: np.ndarray) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))


def _quantiles(values: Float[np.ndarray, " value"], weights: Float[np.ndarray, " value"] | None) -> dict[str, float]:
    found = np.quantile(TO_MICROMETRES * values, (0.5, 0.95), weights=weights, method="inverted_cdf")
    return {"median": float(found[0]), "q95": float(found[1])}
