"""The studies S3, S5 and S6 as run here, with real forward runs, and the true posteriors of S3 and S5."""

import pickle
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from verification.reproduction.field_table import FieldTable, tabulate
from verification.reproduction.truth import TruePosterior, true_posterior
from verification.validation.tables import OUTPUT, STUDIES

from strandline.discrepancy import Currents
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models.fingerprint import fingerprint
from strandline.models.protocol import with_sensitivities
from strandline.parameters import ParameterSpace
from strandline.runs import Ledger, LocalProcesses, RunRecord, RunRequest, run_key
from strandline.runs.record import attempt
from strandline.studies import load_study
from strandline.studies.observed import noisy

NAMES = {"S3": "biofilm-uniform", "S5": "biofilm-inflow", "S6": "biofilm-parts"}
INTERVALS = (12, 6, 6)
"""Intervals of the table of true interfaces, in load, Poisson's ratio and inflow."""


@dataclass(frozen=True, eq=False)
class Case:
    """A study; `run` makes a forward run at one point, with sensitivities if the second argument is true."""

    space: ParameterSpace
    observations: tuple[Observation, ...]
    measure: Currents
    run: Callable[[Float[np.ndarray, " dim"], bool], RunRecord]

    def log_likelihood(self, record: RunRecord) -> float:
        """Return log L of a successful run."""
        return InterfaceLikelihood(self.observations, self.measure)(record.interfaces)


def case(name: str, quadrature: str) -> Case:
    """Return a study with one of the two quadratures."""
    study = load_study(STUDIES / NAMES[name])
    model: Any = study.model

    def run(x: Float[np.ndarray, " dim"], sensitivities: bool) -> RunRecord:
        inputs = {**study.fixed, **study.space.as_mapping(x)}
        request = RunRequest(run_key(fingerprint(model), inputs), inputs)
        with tempfile.TemporaryDirectory() as folder:
            return attempt(with_sensitivities(model) if sensitivities else model, request, Path(folder))

    observed = run(np.array([study.truth[name] for name in study.space.names]), False).interfaces
    if study.synthetic_noise is not None:
        observed = noisy(observed, study.synthetic_noise)
    seen = study.observations(observed)
    return Case(study.space, seen, Currents(0.005, quadrature=quadrature), run)


def truth_of(one: Case) -> TruePosterior:
    """Return the posterior of the true model by direct quadrature, for S3 and S5."""
    likelihood = InterfaceLikelihood(one.observations, one.measure)
    rate = None if "V_in" in one.space.names else 100.0
    return true_posterior(_table(), likelihood, one.space, rate=rate)


@cache
def _table() -> FieldTable:
    """Return the table of true interfaces; the table and its runs are kept in verification/validation/output."""
    kept = OUTPUT / "table.pickle"
    if kept.is_file():
        return pickle.loads(kept.read_bytes())
    model: Any = load_study(STUDIES / NAMES["S3"]).model
    reference: Interface = model.undeformed()
    OUTPUT.mkdir(exist_ok=True)
    with Ledger.open(OUTPUT / "table.sqlite", model=model) as ledger:
        table = tabulate(model, reference, intervals=INTERVALS, ledger=ledger, executor=LocalProcesses())
    kept.write_bytes(pickle.dumps(table))
    return table
