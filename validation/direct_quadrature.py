"""The posterior of the built-in biofilm without any surrogate of the log-likelihood, against those of the studies.

Forward runs at Chebyshev nodes; between them the *interface* is interpolated (it is smooth, unlike the log-likelihood),
the measure is evaluated on the interpolated interfaces, and the posterior is integrated on a grid of Gauss points:
`strandline.reproduction`. Its errors come from runs that the table does not know and from half of each discretisation.

One table over (E, ν, V_in) serves the known inflow rate of the studies and, with ``--uncertain``, the uncertain one of
study S5 in both readings; ``--nested`` sets surrogates of the first 50 … 1000 runs of a study against the truth (S2).
The runs are kept in output/field-table.sqlite; a second call makes none.

Run it with:  python -m validation.direct_quadrature [--nested] [--uncertain] STUDY [STUDY …]
(study folders that `strandline run` finished, with the inputs E and nu)
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.design import sobol
from strandline.interface import Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models.biofilm.model import Biofilm
from strandline.models.protocol import fingerprint
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import ScaledBeta
from strandline.reproduction.batch import batch_log_likelihood
from strandline.reproduction.field_table import FieldTable, TableErrors, tabulate, withheld
from strandline.reproduction.figures import plot_convergence, plot_nested_likelihoods
from strandline.reproduction.grid_posterior import Difference, GridPosterior, Reading
from strandline.reproduction.nested import NestedDesign, NestedStep, nested_surrogates
from strandline.reproduction.truth import TruePosterior, true_fields, true_posterior
from strandline.runs import Executor, Ledger, LocalProcesses, RunRecord, run_campaign, run_key
from strandline.studies import Study, load_study

OUTPUT = Path(__file__).parent / "output"
INTERVALS = (6, 10, 8)
"""Chebyshev intervals in the root of the load, ν and V; even, so that the table of half as many is nested."""
CHECKS = 60
"""Runs anywhere in the table that it does not know, and as many near the posterior."""
FLAT_NODES = (161, 65, 1)
NODES = (97, 41, 33)
PANELS = (48, 24, 20)
READINGS: tuple[Reading, ...] = ("joint", "cut")
INFLOW = Parameter("V_in", ScaledBeta(2.6, 1.4, 0.0, 110.0), "mm^2/s")


def build_table(model: Biofilm, ledger: Ledger, executor: Executor) -> tuple[FieldTable, TableErrors]:
    """Return the table and its errors at random points of the box."""
    table = tabulate(model, model.undeformed(), intervals=INTERVALS, ledger=ledger, executor=executor)
    anywhere = table.coordinates.from_box(np.random.default_rng(0).uniform(-1, 1, (CHECKS, 3)))
    return table, withheld(table, model, anywhere, ledger=ledger, executor=executor)


def likelihood_of(study: Study, truth: RunRecord) -> InterfaceLikelihood:
    """Return the likelihood of the measure that makes the posterior of `study`."""
    assert truth.interface is not None
    discrepancy = next(iter(study.discrepancies.values()))
    return InterfaceLikelihood((Observation(truth.interface, study.noise_variance),), discrepancy)


def near(posterior: GridPosterior, table: FieldTable, rate: float) -> Float[np.ndarray, "run 3"]:
    """Return points about a posterior at a known rate, inside the table."""
    plane = np.random.default_rng(1).multivariate_normal(posterior.mean, posterior.covariance, CHECKS)
    x = np.column_stack([plane, np.full(CHECKS, rate)])
    return np.asarray(x[table.coordinates.inside(x) & (x[:, 0] <= posterior.grid.young.max())])


def log_likelihood_error(table: FieldTable, errors: TableErrors, likelihood: InterfaceLikelihood) -> float:
    """Return the largest error of log L at withheld runs."""
    right, interpolated = (batch_log_likelihood(likelihood, s) for s in (errors.simulated, table.at(errors.x)))
    return float(np.abs(right - interpolated).max())


def moments(posterior: GridPosterior) -> dict[str, Any]:
    """Return what is written of a posterior."""
    correlation = posterior.covariance[0, 1] / posterior.sd.prod()
    return {
        "mean": posterior.mean.tolist(),
        "sd": posterior.sd.tolist(),
        "correlation": float(correlation),
        "log_evidence": posterior.log_evidence,
        "mass_beyond_the_table": posterior.edge_mass,
    }


def largest(difference: Difference) -> float:
    """Return the largest of the differences of means (in sd), standard deviations (relative) and log evidence."""
    return float(np.abs([*difference.mean, *difference.sd_ratio, difference.log_evidence]).max())


def own_errors(truth: TruePosterior) -> dict[str, float]:
    """Return what half of each discretisation does to the posterior."""
    return {
        "half_table": largest(truth.from_half_table),
        "half_nodes": largest(truth.from_half_field),
        "half_grid": largest(truth.from_half_grid),
    }


def study_design(study: Study, likelihood: InterfaceLikelihood) -> NestedDesign:
    """Return the inputs and log-likelihoods of the runs of a finished study, in the order of its design."""
    x = study.space.to_physical(sobol(study.settings.runs, study.space.dim, scramble=study.settings.scramble))
    inputs = [{**study.fixed, **study.space.as_mapping(row)} for row in x]
    with Ledger.open(study.ledger_path, model=fingerprint(study.model), read_only=True) as ledger:
        known = ledger.latest([run_key(fingerprint(study.model), entry) for entry in inputs])
    records = [known[run_key(fingerprint(study.model), entry)] for entry in inputs]
    values = [likelihood(record.interfaces) if record.ok else np.nan for record in records]
    return NestedDesign(x, np.array(values))


def nested_table(steps: tuple[NestedStep, ...]) -> list[dict[str, Any]]:
    """Return what is written of the nested designs."""
    return [
        {
            "runs": step.runs,
            "succeeded": step.succeeded,
            "total_variation": step.total_variation,
            "maximum_likelihood": step.maximum_likelihood.tolist(),
            "mean_difference_sd": step.difference.mean.tolist(),
            "sd_ratio": (1 + step.difference.sd_ratio).tolist(),
            "loo_rms_near_mode": step.loo_rms_near_mode,
            "near_mode": step.near_mode,
        }
        for step in steps
    ]


def uncertain_inflow(study: Study, table: FieldTable, truth: RunRecord) -> dict[str, Any]:
    """Return the true posterior of E and nu where V_in has the prior of study S5, in both readings."""
    space = ParameterSpace((*study.space.parameters, INFLOW))
    likelihood = likelihood_of(study, truth)
    begun = time.perf_counter()
    fields = true_fields(table, likelihood, nodes=NODES)
    result: dict[str, Any] = {"study": study.name, "seconds_fields": time.perf_counter() - begun}
    for reading in READINGS:
        found = true_posterior(table, likelihood, space, reading=reading, fields=fields, panels=PANELS)
        result[reading] = moments(found.posterior) | {"error": own_errors(found)}
    return result | {"seconds": time.perf_counter() - begun}


def compare_study(
    folder: Path, table: FieldTable, anywhere: TableErrors, ledger: Ledger
) -> tuple[dict[str, Any], TruePosterior, InterfaceLikelihood]:
    """Return the comparison of one study with the truth, the truth, and the likelihood."""
    study = load_study(folder)
    rate = float(study.fixed["V_in"])
    truth = observation(study, ledger)
    likelihood = likelihood_of(study, truth)
    begun = time.perf_counter()
    fields = true_fields(table, likelihood, nodes=FLAT_NODES, rate=rate)
    found = true_posterior(table, likelihood, study.space, rate=rate, fields=fields)
    seconds = time.perf_counter() - begun
    points = near(found.posterior, table, rate)
    close = withheld(table, study.model, points, ledger=ledger, executor=study.executor)
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    mean, sd = (np.array([summary["inputs"][n][key] for n in study.space.names]) for key in ("mean", "sd"))
    result = {
        "study": study.name,
        "direct": moments(found.posterior),
        "study_posterior": {"mean": mean.tolist(), "sd": sd.tolist(), "log_evidence": summary["log_evidence"]},
        "mean_difference_sd": ((mean - found.posterior.mean) / found.posterior.sd).tolist(),
        "sd_ratio": (sd / found.posterior.sd).tolist(),
        "error": {
            **own_errors(found),
            "interface_um": float(1e3 * close.distance.max()),
            "log_likelihood_anywhere": log_likelihood_error(table, anywhere, likelihood),
            "log_likelihood_near_posterior": log_likelihood_error(table, close, likelihood),
        },
        "seconds": seconds,
    }
    return result, found, likelihood


def observation(study: Study, ledger: Ledger) -> RunRecord:
    """Return the run that is the synthetic observation of `study`."""
    assert study.truth is not None
    (record,) = run_campaign(study.model, [study.truth], ledger=ledger, executor=study.executor)
    return record


def main(folders: list[Path], *, nested: bool, uncertain: bool) -> None:
    """Print the comparison of each study and write it to output/direct_quadrature.json."""
    OUTPUT.mkdir(exist_ok=True)
    studies = [load_study(folder) for folder in folders]
    model, executor = Biofilm(), LocalProcesses()
    results: list[dict[str, Any]] = []
    designs: dict[str, tuple[NestedStep, ...]] = {}
    with Ledger.open(OUTPUT / "field-table.sqlite", model=fingerprint(model), description="field table") as ledger:
        table, anywhere = build_table(model, ledger, executor)
        for folder, study in zip(folders, studies, strict=True):
            result, found, likelihood = compare_study(folder, table, anywhere, ledger)
            if nested:
                design = study_design(study, likelihood)
                steps = nested_surrogates(design, found.posterior, study.space)
                designs[study.name] = steps
                result["nested"] = nested_table(steps)
                figure = plot_nested_likelihoods(
                    steps,
                    found.posterior,
                    study.space,
                    training=design.x[design.ok],
                    ground_truth=np.array([(study.truth or {})[n] for n in study.space.names]),
                )
                figure.savefig(OUTPUT / f"nested-{study.name}.png", dpi=150)  # type: ignore[union-attr]
            if uncertain:
                result["uncertain_inflow"] = uncertain_inflow(study, table, observation(study, ledger))
            print(json.dumps(result, indent=1), flush=True)
            results.append(result)
    if designs:
        plot_convergence(designs).figure.savefig(OUTPUT / "nested-convergence.png", dpi=150)  # type: ignore[union-attr]
    written = {
        "table": {
            "intervals": INTERVALS,
            "runs": table.runs,
            "interface_um": float(1e3 * anywhere.distance.max()),
            "interface_um_median": float(1e3 * np.median(anywhere.distance)),
        },
        "studies": results,
    }
    (OUTPUT / "direct_quadrature.json").write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="the posterior of the true model against those of finished studies")
    parser.add_argument("studies", nargs="*", type=Path)
    parser.add_argument("--nested", action="store_true", help="surrogates of 50 to 1000 runs against the truth")
    parser.add_argument("--uncertain", action="store_true", help="the inflow rate uncertain, joint and cut")
    chosen = parser.parse_args()
    usual = [Path("studies/biofilm-uniform"), Path("studies/biofilm-uniform-refined")]
    main(chosen.studies or usual, nested=chosen.nested, uncertain=chosen.uncertain)
