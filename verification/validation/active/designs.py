"""Whole calibrations of S3, S5 and S6 by active designs: runs to a certificate, and how far off the posterior is.

For S3 and S5, the largest errors of the mean of E or ν, in sds, and of its sd, from quadrature of the true model. For
S6, the largest shift of a mean that importance weights of the true model at 100 draws tell, in sds, and the share of
draws that they take away; these runs do not count. A coarse run counts as 0.3 of a run, derivatives do not count.

    python -m verification.validation.active.designs [S3 S5 S6] [--options none|differences|sensitivities|both]
        [--seeds 5] [--workers 2]
"""

import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from verification.reproduction.field_table import FieldTable, tabulate
from verification.reproduction.truth import TruePosterior, true_posterior
from verification.validation.tables import OUTPUT, STUDIES, arguments

from strandline.calibration import Calibration
from strandline.foundations import use_double
from strandline.likelihood import InterfaceLikelihood
from strandline.posterior import reweight
from strandline.runs import InProcess, Ledger, LocalProcesses, run_campaign
from strandline.studies import Study, changed_study, load_study, run_study

NAMES = {"S3": "biofilm-uniform-active", "S5": "biofilm-inflow-active", "S6": "biofilm-parts-active"}
OPTIONS = {
    "none": (),
    "differences": ("design.active.differences=true",),
    "sensitivities": ("sensitivities=true",),
    "both": ("sensitivities=true", "fidelities=[coarse]"),
}
INTERVALS = (12, 6, 6)
"""Intervals of the table of true interfaces, in load, Poisson's ratio and inflow."""
DRAWS = 100  # draws of S6: enough to see a shift of 0.1 sd


@cache
def true_interfaces() -> FieldTable:
    """Return the table of true interfaces; its runs are kept in verification/validation/output."""
    model: Any = load_study(STUDIES / NAMES["S3"]).model
    OUTPUT.mkdir(exist_ok=True)
    with Ledger.open(OUTPUT / "table.sqlite", model=model) as ledger:
        return tabulate(model, model.undeformed(), intervals=INTERVALS, ledger=ledger, executor=LocalProcesses())


def by_quadrature(found: Calibration, study: Study) -> tuple[float, float]:
    """Return the largest errors of a mean, in sds, and of an sd."""
    likelihood = InterfaceLikelihood(found.problem.observations, found.problem.measure)
    rate = None if "V_in" in study.space.names else 100.0
    true: TruePosterior = true_posterior(true_interfaces(), likelihood, study.space, rate=rate)
    axes = [study.space.names.index(name) for name in ("E", "nu")]
    mean, sd = found.posterior.mean[axes], found.posterior.sd[axes]
    off, wide = np.abs((mean - true.posterior.mean) / true.posterior.sd), np.abs(sd / true.posterior.sd - 1)
    return float(off.max()), float(wide.max())


def by_weights(found: Calibration, study: Study, seed: int) -> tuple[float, float]:
    """Return the largest shift of a mean, in sds, and the share of draws that does not stay effective."""
    likelihood = InterfaceLikelihood(found.problem.observations, found.problem.measure)
    x = found.posterior.equally_weighted(seed, DRAWS)
    inputs = [{**study.fixed, **study.space.as_mapping(one)} for one in x]
    with tempfile.TemporaryDirectory() as home, Ledger.open(Path(home) / "l.sqlite", model=study.model) as ledger:
        records = run_campaign(study.model, inputs, ledger=ledger, executor=InProcess())
    good = np.array([record.ok for record in records])
    true = np.array([likelihood(record.interfaces) for record in records if record.ok])
    weighted = reweight(x[good], true - found.field.knowledge.expected(x[good]))
    return float(np.abs(weighted.shift).max()), 1 - weighted.smoothed.ess / int(good.sum())


def one(seed: int, name: str, options: str) -> tuple[bool, int, float, float, float]:
    """Return whether a calibration converged, its runs, in equivalents, too, and its two errors."""
    use_double()
    with tempfile.TemporaryDirectory() as home:
        changes = [*OPTIONS[options], f"seed={seed}", f"design.active.scramble={seed}"]
        study = load_study(changed_study(STUDIES / NAMES[name], changes, Path(home) / "study"))
        found = run_study(study, executor=InProcess()).calibration
        certificate = found.certificate
        of_both = certificate.fidelities
        equivalents = len(found.records) if of_both is None else of_both.equivalents
        errors = by_weights(found, study, seed) if name == "S6" else by_quadrature(found, study)
    return certificate.converged, len(found.records), float(equivalents), *errors


def rows(names: list[str], options: str, seeds: int, workers: int) -> Iterator[str]:
    """Yield a line for each calibration and one for all of a study."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for name in names:
            found = []
            for row in pool.map(partial(one, name=name, options=options), range(1, seeds + 1)):
                found.append(row)
                yield "{} {}: converged {}, {} runs, {:.1f} equivalents, off {:.3f}, {:.3f}".format(name, options, *row)
            _, _, counts, off, wide = zip(*found, strict=True)
            worst = f"off at most {max(off):.3f}, {max(wide):.3f}"
            yield f"{name} {options}: median {median(counts):.1f} ({min(counts):.1f} to {max(counts):.1f}), {worst}"


def main() -> None:
    """Print the lines."""
    given = arguments(__doc__, words=tuple(NAMES), options="none", seeds=5, workers=2)
    for line in rows(given.words or list(NAMES), given.options, given.seeds, given.workers):
        print(line, flush=True)


if __name__ == "__main__":
    main()
