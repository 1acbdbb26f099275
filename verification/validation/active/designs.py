"""S3, S5 and S6 with real runs: when the posterior is right, and where whole calibrations stop."""

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax
from verification.reproduction.field_table import FieldTable, tabulate
from verification.reproduction.grid_posterior import posterior_on_grid, product_grid, total_variation
from verification.reproduction.truth import TruePosterior, true_posterior
from verification.validation.tables import OUTPUT, STUDIES

from strandline.calibration import Problem, Settings, calibrate
from strandline.design import sobol
from strandline.design.active import Active, ActiveDesign, Knowledge, State, learn, posterior_state
from strandline.discrepancy import Currents
from strandline.foundations import TooFewRuns, one_thread
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models.identity import fingerprint
from strandline.models.protocol import with_sensitivities
from strandline.parameters import ParameterSpace
from strandline.posterior import Weighted, reweight, subset
from strandline.runs import InProcess, Ledger, LocalProcesses, RunRecord, RunRequest, run_key
from strandline.runs.ledger.record import attempt
from strandline.smc import OnHost, SMCSettings, sample
from strandline.studies import load_study
from strandline.studies.load.observed import noisy

Options = dict[str, Any]
"""Of a design: seed, sensitivities, criterion."""
Course = dict[str, Any]
"""Figures against the number of runs, for one seed."""
NAMES = {"S3": "biofilm-uniform", "S5": "biofilm-inflow", "S6": "biofilm-parts"}
INTERVALS = (12, 6, 6)
"""Intervals of the table of true interfaces, in load, Poisson's ratio and inflow."""
PARTICLES = 6000
RESTLESS = 1e-12
"""Change below which a design would go on to its check; none is as small."""
PANELS = (24, 12, 8)
DRAWS = 100
"""Draws of the posterior of S6 at which the true model checks it: enough to see a shift of 0.1 standard deviations."""
ECONOMY = SMCSettings(rejuvenation_steps=15, zeta=0.5)


@dataclass(frozen=True, eq=False)
class Case:
    """A study; `run` makes a forward run at one point, with sensitivities if the second argument is true."""

    space: ParameterSpace
    observations: tuple[Observation, ...]
    measure: Currents
    run: Callable[[Float[np.ndarray, " dim"], bool], RunRecord]

    def log_likelihood(self, record: RunRecord) -> float:
        return InterfaceLikelihood(self.observations, self.measure)(record.interfaces)


def case(name: str, quadrature: str) -> Case:
    """Return S3, S5 or S6 with this quadrature of the currents."""
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
    """Return the table of true interfaces; its runs are kept in verification/validation/output."""
    model: Any = load_study(STUDIES / NAMES["S3"]).model
    reference: Interface = model.undeformed()
    OUTPUT.mkdir(exist_ok=True)
    with Ledger.open(OUTPUT / "table.sqlite", model=model) as ledger:
        return tabulate(model, reference, intervals=INTERVALS, ledger=ledger, executor=LocalProcesses())


@dataclass(frozen=True, eq=False)
class Grown:
    """A design after a batch: its posterior, its runs, and the seconds that learning, sampling and choosing took."""

    state: State
    runs: int
    failed: int
    seconds: float

    def figures(self) -> dict[str, Any]:
        return {"runs": self.runs, "failed": self.failed, "seconds": self.seconds}


def initial_runs(dim: int, *, sensitivities: bool) -> int:
    """Return the size of the first design, the same as in a study."""
    return 3 if sensitivities else 4 + 2 * dim


def grow(one: Case, options: Options, *, batch: int, most: int, share: float = 0.0) -> Iterator[Grown]:
    """Yield the design after each batch, up to `most` runs; a share of the runs fails at random, wherever they are."""
    space, seed, sensitivities = one.space, options["seed"], options["sensitivities"]
    first, chance = initial_runs(space.dim, sensitivities=sensitivities), np.random.default_rng([seed, 77])
    active = Active(
        runs=most + batch + Active.check, initial=first, batch=batch, criterion=options["criterion"], change=RESTLESS
    )

    def posterior(x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]) -> State:
        known = learn(x, records, space, one.observations, one.measure)
        return posterior_state(known, space, (seed, len(x)))

    def runs(x: Float[np.ndarray, "run dim"]) -> list[RunRecord]:
        gone = {"state": "failed", "interfaces": {}, "sensitivities": {}, "failure_kind": "at_random"}
        found = [(one.run(row, sensitivities), chance.random() < share) for row in x]
        return [replace(record, **gone) if record.ok and fails else record for record, fails in found]

    design = ActiveDesign(
        active, space, batch=batch, learn=posterior, log_likelihood=one.log_likelihood, seed=seed, scramble=seed
    )
    for x, records, seconds in play(design, space.to_physical(sobol(first, space.dim, scramble=seed)), runs):
        if design.state is not None:
            yield Grown(design.state, len(x), sum(not record.ok for record in records), seconds)
        if len(x) + batch > most:
            return


def play(
    design: ActiveDesign, x: Float[np.ndarray, "run dim"], runs: Callable[[np.ndarray], list[RunRecord]]
) -> Iterator[tuple[Float[np.ndarray, "run dim"], list[RunRecord], float]]:
    """Yield inputs, records and the seconds of choosing after each batch of a design, from first inputs to its end."""
    design.start(x)
    records = runs(x)
    while True:
        begun = time.perf_counter()
        try:
            with one_thread():
                more = design.next(x, records)
        except TooFewRuns:
            more = design.more_of_the_first()
        yield x, records, time.perf_counter() - begun
        if more is None:
            return
        x = np.concatenate([x, more.points])
        records = records + runs(more.points)


def delivered(one: Case, knowledge: Knowledge, seed: int) -> Weighted:
    """Return the posterior as a study computes it at the end, with enough particles to judge it."""
    host = OnHost(knowledge.nearly_expected)
    initial = one.space.prior_quantiles(np.random.default_rng([seed, 9]).random((PARTICLES, one.space.dim)))
    with one_thread():
        found = sample(jax.random.key(seed), host, one.space.log_prior, initial, settings=ECONOMY)
        expected = knowledge.expected(found.positions, plug_in=knowledge.plug_in(found.positions))
    weights = np.exp(log_softmax(found.log_weights + expected - found.log_likelihood))
    return Weighted(found.positions, weights)


def s3(quadrature: str, options: Options, *, most: int, share: float = 0.0) -> Course:
    """Return the total variation to the true posterior over the (E, nu) plane; a `share` of runs fails at random."""
    one, points = case("S3", quadrature), []
    grid = product_grid(one.space, panels=PANELS, rate=100.0)
    true = posterior_on_grid(truth_of(one).field, one.space, grid)
    for grown in grow(one, options, batch=2, most=most, share=share):
        known = grown.state.knowledge
        found = posterior_on_grid(lambda x, known=known: known.expected(x[:, :2]), one.space, grid)
        variation = {"total_variation": total_variation(found, true)}
        points.append(grown.figures() | variation | errors(found.mean, found.sd, true))
    return _course("S3", quadrature, options, points, share)


def s5(quadrature: str, options: Options, *, most: int) -> Course:
    """Return the errors of mean and standard deviation of (E, nu) with the inflow integrated out: the joint reading."""
    one, points = case("S5", quadrature), []
    truth, axes = truth_of(one).posterior, [one.space.names.index(name) for name in ("E", "nu")]
    for grown in grow(one, options, batch=4, most=most):
        found = delivered(one, grown.state.knowledge, options["seed"])
        points.append(grown.figures() | errors(found.mean[axes], found.sd[axes], truth))
    return _course("S5", quadrature, options, points)


def s6(quadrature: str, options: Options, *, most: int, first: int) -> Course:
    """Return the importance weights by the true model at draws of the posterior, from `first` runs on."""
    one, points = case("S6", quadrature), []
    for grown in grow(one, options, batch=4, most=most):
        points.append(grown.figures() | (checked(one, grown, options["seed"]) if grown.runs >= first else {}))
        if right(points[-1]):
            break
    return _course("S6", quadrature, options, points)


def _course(study: str, quadrature: str, options: Options, points: list, share: float = 0.0) -> Course:
    return {"study": study, "quadrature": quadrature, **options, "points": points, "share": share}


def right(point: dict[str, Any]) -> bool:
    """Return whether a posterior of S6 is right."""
    return point.get("effective", 0.0) >= 0.8 and point["k_hat"] < 0.5 and point["shift"] < 0.1


def errors(mean: np.ndarray, sd: np.ndarray, truth: Any) -> dict[str, float]:
    """Return the largest errors of a mean, in standard deviations, and of a standard deviation, as a share."""
    off, wide = np.abs((mean - truth.mean) / truth.sd), np.abs(sd / truth.sd - 1)
    return {"mean_error": float(off.max()), "sd_error": float(wide.max())}


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
        "failed_draws": int((~good).sum()),
    }


def stopped(name: str, quadrature: str, *, sensitivities: bool, seed: int) -> dict[str, Any]:
    """Calibrate S3 or S5 (joint reading) with an active design, and compare with quadrature of the true model.

    `chosen` are the runs without those of a check at the end.
    """
    one, study = case(name, quadrature), load_study(STUDIES / NAMES[name])
    model: Any = with_sensitivities(study.model) if sensitivities else study.model
    dim = one.space.dim
    first = initial_runs(dim, sensitivities=sensitivities)
    active = Active(runs=200, initial=first, batch=2 if dim < 3 else 4)
    design = {"runs": first, "scramble": seed, "active": active, "surrogate": "field"}
    settings = Settings(particles=4000, smc=ECONOMY, seed=seed, nuisance_values=2, **design)
    problem = Problem(model, one.space, study.fixed, one.observations, {"currents": one.measure})
    with tempfile.TemporaryDirectory() as home, Ledger.open(Path(home) / "l.sqlite", model=model) as ledger:
        found = calibrate(problem, settings, ledger=ledger, executor=InProcess())
    certificate, posterior = found.field.certificate, found.posterior
    axes = [one.space.names.index(name) for name in ("E", "nu")]
    last_check = len(certificate.batches[-1].points) if certificate.batches[-1].kind == "check" else 0
    runs = {"runs": len(found.records), "chosen": len(found.records) - last_check, "converged": certificate.converged}
    of = {"study": name, "quadrature": quadrature, "sensitivities": sensitivities, "seed": seed}
    return of | runs | errors(posterior.mean[axes], posterior.sd[axes], truth_of(one).posterior)
