"""Reproduce the whole published study: run its six examples, judge its ten claims, write one page."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from verification.reproduction import claims
from verification.reproduction.evidence import RULES, Evidence, Plan, gather, require_studies
from verification.reproduction.judgement import Claim, LikelihoodField
from verification.reproduction.page import write_claims, write_page

from strandline.calibration import Calibration, Observer
from strandline.runs import Executor
from strandline.studies.keys.folder import told_if_unwritable

GRID = 241


@dataclass(frozen=True)
class Reproduction:
    """The evidence, the judged claims, and the paths of the files."""

    evidence: Evidence
    claims: dict[str, Claim]
    page: Path
    claims_file: Path


def reproduce(
    studies: Path,
    folder: Path,
    *,
    plan: Plan | None = None,
    executor: Executor | None = None,
    observer: Observer | None = None,
) -> Reproduction:
    """Run everything, judge the claims, and write report.html and claims.json into `folder`.

    Forward runs that a ledger holds are not repeated: a second call goes on where the first one stopped. `studies` is
    the folder that holds the study folders; without an executor, theirs make the runs.
    """
    begun, tell = time.perf_counter(), observer or Observer()
    require_studies(studies)
    with told_if_unwritable(folder):
        folder.mkdir(parents=True, exist_ok=True)
    evidence = gather(studies, folder, plan=plan or Plan(), executor=executor, observer=tell)
    judged = judge(evidence)
    tell.stage("page")
    page = write_page(evidence, judged, folder)
    return Reproduction(evidence, judged, page, write_claims(evidence, judged, folder, time.perf_counter() - begun))


def judge(evidence: Evidence) -> dict[str, Claim]:
    """Return the claims by key, C1 to C10; every verdict follows from numbers."""
    found = {name: outcome.calibration for name, outcome in evidence.outcomes.items()}
    uniform, refined, measures = (found[f"biofilm-{n}"] for n in ("uniform", "uniform-refined", "measures"))
    truth, space = evidence.studies["biofilm-uniform"].truth or {}, uniform.problem.space
    at = [truth[name] for name in space.names]
    spacing = ((space.high - space.low) / np.sqrt(len(measures.records))).tolist()
    fields = likelihood_fields(measures)
    nested = {rule: {step.runs: step for step in steps} for rule, steps in evidence.nested.items()}
    convergence, truths = evidence.convergence, evidence.truths
    judged = (
        claims.ridge_and_peak(fields, at, uniform.posterior, spacing),
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
            {reading: one.posterior for reading, one in truths.uncertain["centre"].items()},
            truths.certain["centre"].posterior,
        ),
        claims.heterogeneous(
            found["biofilm-parts"].posterior,
            {name: check.content for name, check in evidence.checks.items() if name.startswith("biofilm-parts")},
            evidence.studies["biofilm-parts"].truth or {},
        ),
        claims.more_runs(
            convergence["centre"].sizes,
            {f"log-likelihood, {rule}": convergence[rule].log_likelihood for rule in RULES}
            | {f"likelihood, {rule}": convergence[rule].likelihood for rule in RULES},
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
