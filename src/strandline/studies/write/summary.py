"""summary.json: all results of a finished study, for programs.

Its entries on a surrogate of the field are at the end: the surrogate, its certificate, and a comparison.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.calibration import Calibration
from strandline.design import BatchCheck, FidelityReport, FieldOutcome, Step, shifts
from strandline.discrepancy import Discrepancy
from strandline.interface import Observation, UnknownErrors, steady_lengths
from strandline.likelihood import InterfaceLikelihood, NoisePosterior, adapted, compared
from strandline.parameters import ParameterSpace
from strandline.posterior import MarginalPosterior, Posterior, QuadratureResult, mixture
from strandline.report import as_json, fields_as_json, find_warnings, fit_as_json, nearest_runs, without_coefficients
from strandline.runs import EXCLUDED, outcome_digest
from strandline.studies.foresight.check import outcomes
from strandline.studies.foresight.measure_doubts import contradictions
from strandline.studies.foresight.widths import outline_effect
from strandline.studies.keys.parse import in_words
from strandline.studies.load.provenance import facts_of, named, observation_digest
from strandline.studies.load.study import Study
from strandline.studies.write.shown import read_how
from strandline.surrogate import GaussianProcess, LogLikelihoodSurrogate

QUANTILES = (0.05, 0.5, 0.95)


def summarise(study: Study, calibration: Calibration, *, new_runs: int, reused_runs: int) -> dict[str, Any]:
    """Return the summary as plain numbers, texts, lists and dicts."""
    sampling, field, nearest = calibration.sampling, calibration.field, _nearest(calibration)
    posterior, exact, laplace = calibration.posterior, calibration.quadrature, calibration.laplace
    content = {
        **facts_of(study, study.settings.seed),
        "draft": study.settings.draft,
        "runs": outcomes(calibration.all_runs) | {"new": new_runs, "reused": reused_runs},
        "observation_sha256": observation_digest(study),
        "ledger_sha256": outcome_digest(study.ledger_path, frozenset(study.runs.needed_keys)),
        "set_aside": [asdict(one) for one in calibration.set_aside],
        "excluded": [
            {"key": record.key, "inputs": dict(record.inputs), "why": record.message}
            for record in calibration.all_runs
            if record.state == EXCLUDED
        ],
        "nearest": nearest,
        "misfit": fit_as_json(calibration.misfit, nearest["message"]),
        "refinement": _refinement(calibration),
        "fixed": dict(study.fixed),
        "truth": None if study.truth is None else dict(study.truth),
        "synthetic_noise": None if study.synthetic_noise is None else asdict(study.synthetic_noise),
        "inputs": _inputs(calibration),
        "correlation": [{"between": list(pair), "value": value} for pair, value in study.space.correlation.items()],
        "fields": fields_as_json(posterior, study.truth),
        "log_evidence": posterior.log_evidence,
        "likelihood": _likelihood(calibration),
        "pictures": read_how(study),
        "undeformed_outline": outline_effect(study, calibration.records, posterior),
        "surrogate": _surrogate(calibration.surrogate) if field is None else field_surrogate(calibration, field),
        "no_field": calibration.no_field,
        "certificate": certificate(calibration),
        "comparison": comparison(calibration),
        "measures": {name: _surrogate(s) for name, s in calibration.surrogates.items()},
        "sampler": {
            "kind": "chains" if field is not None and field.by_chains else "smc",
            "particles": study.settings.particles,
            **named(study.settings.smc, "rejuvenation_steps", "zeta"),
            "tempering_steps": len(sampling.steps),
            "likelihood_evaluations": sampling.likelihood_evaluations,
            "ess": sampling.ess if field is None else posterior.ess,
        },
        "gaussian": {"covariance": _of_scalars(calibration.gaussian.covariance, posterior.space)},
        "laplace": {
            "definite": laplace.definite,
            "eigenvalues": laplace.eigenvalues.tolist(),
            "covariance": _of_scalars(laplace.covariance, posterior.space),
        },
        "quadrature_check": None if exact is None else _compared(posterior.space.names, posterior, exact),
        "sampler_check": sampler_check(calibration),
        "under_uncertainty": _under_uncertainty(calibration),
        "sensitivity": _sensitivity(calibration),
        "missing": {},
        "warnings": [
            *(f"{one[0].upper()}{one[1:]}." for one in contradictions(study)),
            *find_warnings(calibration, turned=(*study.turned, *calibration.turned)),
        ],
        "seconds": dict(calibration.seconds),
    }
    shown: dict[str, Any] = without_coefficients(content, posterior.space)
    return shown


def sampler_check(calibration: Calibration) -> dict[str, Any] | None:
    """Return how two independent halves of the particles compare; None up to three inputs."""
    check = calibration.sampler_check
    if check is None:
        return None
    split = check.split
    return {
        **named(check, "agree", "verdict", "p"),
        "effective": list(check.effective),
        "mean_difference_sd": dict(zip(check.names, check.mean_difference.tolist(), strict=True)),
        "sd_ratio": dict(zip(check.names, np.exp(check.log_sd_ratio).tolist(), strict=True)),
        "split": {"of": split.of, "at": split.at, "shares": list(split.shares)},
        "log_evidence": list(check.log_evidence),
    }


def _compared(names: Sequence[str], sampled: Posterior | MarginalPosterior, exact: QuadratureResult) -> dict[str, Any]:
    return dict(zip(names, _rows(mean=exact.mean, sd=exact.sd), strict=True)) | {
        "max_mean_error_sd": float(np.max(np.abs(sampled.mean - exact.mean) / exact.sd)),
        "max_sd_ratio_error": float(np.max(np.abs(sampled.sd / exact.sd - 1.0))),
        **named(exact, "log_evidence", "converged", "evaluations"),
    }


def _under_uncertainty(calibration: Calibration) -> dict[str, Any] | None:
    found = calibration.under_uncertainty
    if found is None:
        return None
    space, cut, parts = calibration.problem.space, found.cut, calibration.cut_quadrature
    return {
        "joint": _reading(found.joint),
        "cut": _reading(cut)
        | {
            "nuisance_values": {
                space.names[i]: column.tolist() for i, column in zip(space.nuisance, cut.values.T, strict=True)
            },
            "log_evidence": cut.log_evidence.tolist(),
            "joint_log_evidence": cut.joint_log_evidence,
            "particles": cut.extended.number,
            "ess": cut.extended.ess,
            "quadrature_check": None if parts is None else _compared(cut.names, cut, mixture(parts)),
        },
    }


def _reading(reading: MarginalPosterior) -> dict[str, Any]:
    return {
        "inputs": dict(zip(reading.names, _moments(reading), strict=True)),
        "map_bins": reading.map_bins,
        "covariance": _of_scalars(reading.covariance, reading.extended.space.calibrated_space),
    }


def _of_scalars(covariance: Float[np.ndarray, "dim dim"] | None, space: ParameterSpace) -> list[list[float]] | None:
    """Return a covariance without the coefficients of fields; posterior.nc has their draws."""
    kept = [space.names.index(name) for name in space.scalars]
    return None if covariance is None else covariance[np.ix_(kept, kept)].tolist()


def _moments(found: Posterior | MarginalPosterior) -> list[dict[str, float]]:
    q05, median, q95 = found.quantiles(QUANTILES)
    return _rows(mean=found.mean, sd=found.sd, median=median, q05=q05, q95=q95, map=found.map_estimate)


def _rows(**columns: Float[np.ndarray, " input"]) -> list[dict[str, float]]:
    return [dict(zip(columns, row, strict=True)) for row in np.column_stack([*columns.values()]).tolist()]


def _nearest(calibration: Calibration) -> dict[str, Any]:
    values = np.asarray(next(iter(calibration.log_likelihoods.values())))
    problem = calibration.problem
    if calibration.field is not None:
        problem = replace(problem, observations=calibration.field.knowledge.likelihood.known_observations)
    return as_json(nearest_runs(problem, calibration.records, values))


def _refinement(calibration: Calibration) -> list[dict[str, Any]]:
    posterior = calibration.posterior
    return [
        {
            **named(r, "n_train", "runs", "failed", "error_rms", "error_rms_posterior"),
            "shift": dict(zip(posterior.space.names, shift.tolist(), strict=True)),
        }
        for r, shift in zip(calibration.rounds, shifts(calibration.rounds, posterior.mean, posterior.sd), strict=True)
    ]


def _inputs(calibration: Calibration) -> dict[str, Any]:
    posterior = calibration.posterior
    return {
        parameter.name: {
            "label": parameter.shown,
            "unit": parameter.unit,
            **moments,
            "nuisance": parameter.nuisance,
            "prior": in_words(parameter.prior),
            "box": list(parameter.interval),
            "prior_mass_cut": parameter.mass_cut,
        }
        for parameter, moments in zip(posterior.space, _moments(posterior), strict=True)
    }


def _likelihood(calibration: Calibration) -> dict[str, Any]:
    name, discrepancy = next(iter(calibration.problem.discrepancies.items()))
    observations = calibration.problem.observations
    likelihood = InterfaceLikelihood(observations, discrepancy)
    run = next(record for record in calibration.records if record.ok)
    nodes = {name: len(interface.points) for name, interface in run.interfaces.items()}
    return {
        "discrepancy": name,
        "options": in_words(adapted(discrepancy, observations[0])),
        "unit": likelihood.unit,
        **_noise(observations[0], discrepancy, nodes[observations[0].condition]),
        **inferred_noise(calibration),
        "conditions": [
            {"condition": o.condition, **_noise(o, discrepancy, nodes[o.condition]), "points": len(o.interface.points)}
            for o in observations
        ],
        "independent_terms": likelihood.independent_terms,
        "gaussian_constant": likelihood.constant,
    }


def _noise(observation: Observation, discrepancy: Discrepancy, nodes: int) -> dict[str, float]:
    return {**observation.noise.facts, **compared(observation, discrepancy, nodes).noise.facts}


def _surrogate(surrogate: LogLikelihoodSurrogate) -> dict[str, Any]:
    process, validation = surrogate.process, surrogate.validation
    return {
        "kind": "log_likelihood",
        "n_train": len(validation.residuals),
        **named(validation, "loo_rms", "loo_rms_near_mode", "near_mode_count"),
        "hyperparameters": {
            "length_scale": np.asarray(process.length_scale).tolist(),
            "signal_variance": float(process.signal_variance),
            "nugget": float(process.nugget),
        }
        if isinstance(process, GaussianProcess)
        else None,
        "optimiser": _plain(asdict(surrogate.fit)) if surrogate.fit else None,
    }


def _sensitivity(calibration: Calibration) -> dict[str, Any] | None:
    indices = calibration.sensitivity
    if indices is None:
        return None
    rows = _rows(**named(indices, "first", "first_low", "first_high", "total", "total_low", "total_high"))
    return {
        "of": "log-likelihood",
        "inputs": dict(zip(calibration.problem.space.names, rows, strict=True)),
        "evaluations": indices.evaluations,
    }


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: value.item() if isinstance(value, np.generic) else value
        for key, value in values.items()
        if isinstance(value, str | int | float | bool | np.generic) or value is None
    }


TO_MICROMETRES = 1e3
LEVELS = {"q05": 0.05, "median": 0.5, "q95": 0.95}  # quantiles of inferred noise and of an error of the model


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
            "largest_shift": float(np.abs(found.effect.shift).max()),
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
        of["without_model_error"] = dict(zip(calibration.problem.space.names, _rows(**without), strict=True))
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
        "exact": given.drawn or None,
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
        **named(found, "equivalents", "pairs"),
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
    shift, ratio = (other["mean"] - posterior.mean) / posterior.sd, other["sd"] / posterior.sd
    rows = _rows(mean=other["mean"], sd=other["sd"], shift_sd=shift, sd_ratio=ratio)
    return {"inputs": dict(zip(posterior.space.names, rows, strict=True))}


def _check(found: BatchCheck, step: Step | None, names: tuple[str, ...]) -> dict[str, Any]:
    weights, moments = found.reweighting, ("shift", "shift_error", "sd_ratio")
    of: dict[str, Any] = dict.fromkeys(("k_hat", "effective", "largest_shift", *moments))
    if weights is not None:
        k_hat, each = weights.smoothed.k_hat, weights.smoothed.log_weights
        of = {"k_hat": k_hat if np.isfinite(k_hat) else None, "effective": weights.smoothed.ess / len(each)}
        of |= {name: _by_name(names, getattr(weights, name)) for name in moments}
        of["largest_shift"] = float(np.abs(weights.shift).max())
    return {
        "by": "left-out runs" if step is not None and step.kind == "given" else "runs at draws of the posterior",
        **named(found, "passed", "draws", "failed", "left_out", "early", "ratio_sd", "bound"),
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
