"""Judge all ten claims by the evidence."""

import numpy as np
from verification.reproduction import claims, claims_parts
from verification.reproduction.evidence import RULES, Evidence
from verification.reproduction.judgement import Claim, LikelihoodField

from strandline.calibration import Calibration

__all__ = ["judge", "likelihood_fields"]

GRID = 241


def judge(evidence: Evidence) -> dict[str, Claim]:
    """Return the claims by key, C1 to C10; every verdict follows from numbers."""
    found = {name: outcome.calibration for name, outcome in evidence.outcomes.items()}
    uniform, refined, measures = (found[f"biofilm-{n}"] for n in ("uniform", "uniform-refined", "measures"))
    truth = evidence.studies["biofilm-uniform"].truth or {}
    space = uniform.problem.space
    at = [truth[name] for name in space.names]
    width = space.high - space.low
    fields = likelihood_fields(measures)
    nested = {rule: {step.runs: step for step in steps} for rule, steps in evidence.nested.items()}
    parts = evidence.studies["biofilm-parts"].truth or {}
    convergence, truths = evidence.convergence, evidence.truths
    judged = (
        claims.ridge_and_peak(fields, at, uniform.posterior, (width / np.sqrt(len(measures.records))).tolist()),
        claims.measures_compared(fields),
        claims.failed_where_unlikely(measures.records, fields, space.names),
        claims.training_size(
            {rule: {n: s.total_variation for n, s in steps.items()} for rule, steps in nested.items()},
            {rule: {n: s.maximum_likelihood.tolist() for n, s in steps.items()} for rule, steps in nested.items()},
            at,
        ),
        claims.uniform_prior(uniform.posterior, refined.posterior),
        claims.laplace_misleads({"centre": uniform, "refined": refined}),
        claims.informed_prior(found["biofilm-informed"].posterior, uniform.posterior),
        claims.uncertain_inflow(
            evidence.outcomes["biofilm-inflow"].summary["under_uncertainty"],
            uniform.posterior,
            {"joint": truths.joint["centre"].posterior, "cut": truths.cut["centre"].posterior},
            truths.certain["centre"].posterior,
        ),
        claims_parts.heterogeneous(
            found["biofilm-parts"].posterior,
            {name: check.content for name, check in evidence.checks.items() if name.startswith("biofilm-parts")},
            parts,
        ),
        claims_parts.more_runs(
            next(iter(convergence.values())).sizes.tolist(),
            {f"log-likelihood, {rule}": convergence[rule].log_likelihood.tolist() for rule in RULES}
            | {f"likelihood, {rule}": convergence[rule].likelihood.tolist() for rule in RULES},
        ),
    )
    return {claim.key: claim for claim in judged}


def likelihood_fields(calibration: Calibration) -> dict[str, LikelihoodField]:
    """Return the mean of each measure's surrogate on a grid over the box of two inputs."""
    x, y = (np.linspace(*parameter.interval, GRID) for parameter in calibration.problem.space)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return {
        name: LikelihoodField(x, y, surrogate.process.mean(points).reshape(GRID, GRID))
        for name, surrogate in calibration.surrogates.items()
    }
