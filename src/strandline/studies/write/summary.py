"""summary.json: all results of a finished study, for programs."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from strandline.calibration import Calibration
from strandline.design import shifts
from strandline.discrepancy import Discrepancy
from strandline.interface import Observation
from strandline.likelihood import InterfaceLikelihood, adapted, compared
from strandline.posterior import Posterior, QuadratureResult, Reading, mixture
from strandline.report import as_json, find_warnings, fit_as_json, nearest_runs
from strandline.runs import EXCLUDED, outcome_digest
from strandline.studies.foresight.check import outcomes
from strandline.studies.foresight.measure_doubts import contradictions
from strandline.studies.foresight.widths import outline_effect
from strandline.studies.keys.parse import in_words
from strandline.studies.load.provenance import facts_of, named, observation_digest
from strandline.studies.load.study import Study
from strandline.studies.write.shown import read_how
from strandline.studies.write.summary_field import certificate, comparison, field_surrogate, inferred_noise
from strandline.surrogate import GaussianProcess, LogLikelihoodSurrogate

QUANTILES = (0.05, 0.5, 0.95)


def summarise(study: Study, calibration: Calibration, *, new_runs: int, reused_runs: int) -> dict[str, Any]:
    """Return the summary as plain numbers, texts, lists and dicts."""
    sampling, nearest = calibration.sampling, _nearest(calibration)
    posterior, exact, laplace = calibration.posterior, calibration.quadrature, calibration.laplace
    return {
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
        "log_evidence": posterior.log_evidence,
        "likelihood": _likelihood(calibration),
        "pictures": read_how(study),
        "undeformed_outline": outline_effect(study, calibration.records, posterior),
        "surrogate": _surrogate(calibration.surrogate)
        if calibration.field is None
        else field_surrogate(calibration, calibration.field),
        "no_field": calibration.no_field,
        "certificate": certificate(calibration),
        "comparison": comparison(calibration),
        "measures": {name: _surrogate(s) for name, s in calibration.surrogates.items()},
        "sampler": {
            "particles": study.settings.particles,
            **named(study.settings.smc, "rejuvenation_steps", "zeta"),
            "tempering_steps": len(sampling.steps),
            "likelihood_evaluations": sampling.likelihood_evaluations,
            "ess": sampling.ess if calibration.field is None else posterior.ess,
        },
        "gaussian": {"covariance": calibration.gaussian.covariance.tolist()},
        "laplace": {
            "definite": laplace.definite,
            "eigenvalues": laplace.eigenvalues.tolist(),
            "covariance": None if laplace.covariance is None else laplace.covariance.tolist(),
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


def _compared(names: Sequence[str], sampled: Posterior | Reading, exact: QuadratureResult) -> dict[str, Any]:
    per_input = {n: {"mean": float(m), "sd": float(s)} for n, m, s in zip(names, exact.mean, exact.sd, strict=True)}
    return per_input | {
        "max_mean_error_sd": float(np.max(np.abs(sampled.mean - exact.mean) / exact.sd)),
        "max_sd_ratio_error": float(np.max(np.abs(sampled.sd / exact.sd - 1.0))),
        **named(exact, "log_evidence", "converged", "evaluations"),
    }


def _under_uncertainty(calibration: Calibration) -> dict[str, Any] | None:
    """Return both readings of the posterior of the calibrated inputs; None without nuisance inputs."""
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


def _reading(reading: Reading) -> dict[str, Any]:
    return {
        "inputs": dict(zip(reading.names, _moments(reading), strict=True)),
        "map_bins": reading.map_bins,
        "covariance": reading.covariance.tolist(),
    }


def _moments(found: Posterior | Reading) -> list[dict[str, float]]:
    """Return mean, standard deviation, quantiles and mode of each input."""
    q05, median, q95 = found.quantiles(QUANTILES)
    columns = {"mean": found.mean, "sd": found.sd, "median": median, "q05": q05, "q95": q95, "map": found.map_estimate}
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
    """Return the measure, the noise of the first condition and of each, and the constant left out of the likelihood."""
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
    kinds = ("first", "first_low", "first_high", "total", "total_low", "total_high")
    names = calibration.problem.space.names
    return {
        "of": "log-likelihood",
        "inputs": {name: {kind: float(getattr(indices, kind)[i]) for kind in kinds} for i, name in enumerate(names)},
        "evaluations": indices.evaluations,
    }


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the plain values among `values`, which JSON can hold."""
    return {
        key: value.item() if isinstance(value, np.generic) else value
        for key, value in values.items()
        if isinstance(value, str | int | float | bool | np.generic) or value is None
    }
