"""Can interfaces tell a Saint-Venant–Kirchhoff solid from a neo-Hookean one? The biofilm on its coarse mesh.

First, ln B of `strandline compare` against quadrature of the true models, for one, two and three inflow rates:
Gauss–Legendre nodes along the ridge of each posterior, a run of the true model at each; a run that fails has no
likelihood. The data are the interfaces of the first law at E = 400 Pa, ν = 0.3. Second, crossings: true inputs from the
prior, each law in turn, observed with errors of the points; surrogates of both laws give Bayes factors, and a posterior
averaged over the laws. Its 90 % intervals should contain the truth whichever law is right.

    python -m verification.validation.compare_laws [--nodes 12] [--crossings 40] [--folder FOLDER] [--publish]

0 nodes or 0 crossings leave that part out. A folder keeps studies and runs.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from jaxtyping import Float
from scipy.special import logsumexp, softmax
from verification.validation.tables import DOCS, Table, arguments, finish, kept_or_scratch, show, table, write_study

import strandline as sl
from strandline.calibration.evidence import ModelComparison, averaged, evidence_of, integrated
from strandline.design import sobol
from strandline.design.active import Knowledge, learn
from strandline.foundations import one_thread, use_double
from strandline.likelihood import FieldLikelihood
from strandline.posterior import Weighted

LAWS = ("saint_venant_kirchhoff", "neo_hookean")
RATES = ({"v100": 100.0}, {"v50": 50.0, "v100": 100.0}, {"v50": 50.0, "v100": 100.0, "v125": 125.0})
TRUTH = {"E": 400.0, "nu": 0.3}
SPACE = sl.ParameterSpace((sl.Parameter("E", sl.Uniform(100, 800), "Pa"), sl.Parameter("nu", sl.Uniform(-0.8, 0.5))))
MEASURE, VARIANCE = sl.Currents(0.005, quadrature="refined"), 0.0005
WIDE = 6.0
"""Half the width of the quadrature's box, in standard deviations of the posterior, inside the prior."""
SD = 0.003
"""Standard deviation of the observed points of the crossings, mm."""
Nodes = Float[np.ndarray, " node"]
DESIGN = 192
"""Runs of each law from which the interface is learnt over the whole prior."""
ROUGH = 1024
"""Draws of the prior that show where the posterior of a crossing lies."""
WITHIN, COVERED = 0.2, 0.85
"""Largest error of ln B, and least share of the intervals that contain the truth."""
PAGE = DOCS / "results" / "accuracy.md"


STUDY = """
version: 1
inputs:
  E: {prior: {uniform: [100, 800]}, unit: Pa}
  nu: {prior: {uniform: [-0.8, 0.5]}}
discrepancy: {currents: {width: 0.005, quadrature: refined}}
noise: {variance: 0.0005}
design: {active: {runs: 100}}
surrogate: {field: {}}
sampler: {smc: {particles: 2000, rejuvenation_steps: 10, zeta: 0.5}}
executor: {local: {workers: 1, timeout: 120}}
"""


def model(law: str, rates: dict[str, float]) -> sl.Biofilm:
    """Return the biofilm of one law, with one interface for each rate."""
    return sl.Biofilm(mesh="coarse", material=law, inflow_rates=tuple(rates.items()))


def runs_of(law: str, rates: dict[str, float], x: Float[np.ndarray, "run 2"], folder: Path) -> list[sl.RunRecord]:
    """Return the records of runs, which the folder keeps."""
    simulator = model(law, rates)
    with sl.Ledger.open(folder / f"{law}-{len(rates)}.sqlite", model=simulator) as ledger:
        given = [SPACE.as_mapping(row) for row in x]
        return list(sl.run_campaign(simulator, given, ledger=ledger, executor=sl.InProcess()))


def study(law: str, rates: dict[str, float], folder: Path) -> sl.Study:
    """Write the study of one law, with the data in files beside it, and return it."""
    content = yaml.safe_load(STUDY)
    content |= {"name": law, "model": {"biofilm": {"mesh": "coarse", "material": law, "inflow_rates": rates}}}
    content["observation"] = [{"condition": name, "file": f"../{name}.csv", "unit": "mm"} for name in rates]
    return sl.load_study(write_study(folder / f"{len(rates)}-rates" / law, content))


def data(rates: dict[str, float], folder: Path) -> tuple[sl.Observation, ...]:
    """Return the interfaces of the first law, and write them to files."""
    home = folder / f"{len(rates)}-rates"
    home.mkdir(parents=True, exist_ok=True)
    interfaces = model(LAWS[0], rates)(TRUTH, home).interfaces
    for name in rates:
        np.savetxt(home / f"{name}.csv", interfaces[name].points, delimiter=",", fmt="%.17g")
    return tuple(sl.Observation(interfaces[name], VARIANCE, name) for name in rates)


def by_quadrature(
    law: str, rates: dict[str, float], seen: tuple, posterior: sl.Posterior, nodes: int, folder: Path
) -> tuple[float, int]:
    """Return the log-evidence of the true model where a posterior lies, and the number of runs that failed.

    The nodes follow the ridge of the posterior: those of E lie about its conditional mean at each node of ν.
    """
    places, weights = np.polynomial.legendre.leggauss(nodes)
    (mean, mean_nu), covariance = posterior.mean, posterior.covariance
    slope = covariance[0, 1] / covariance[1, 1]
    narrow = float(np.sqrt(covariance[0, 0] - slope * covariance[0, 1]))
    nu, mass_nu = _nodes(mean_nu, posterior.sd[1], 1, places, weights)
    rows = [_nodes(mean + slope * (one - mean_nu), narrow, 0, places, weights) for one in nu]
    x = np.column_stack([np.concatenate([row for row, _ in rows]), np.repeat(nu, nodes)])
    mass = np.concatenate([one * row for one, (_, row) in zip(mass_nu, rows, strict=True)])
    records = runs_of(law, rates, x, folder)
    likelihood = sl.InterfaceLikelihood(seen, MEASURE)
    values = np.array([likelihood(record.interfaces) if record.ok else -np.inf for record in records])
    return float(logsumexp(values, b=mass)), sum(not record.ok for record in records)


def _nodes(mean: float, sd: float, column: int, places: Nodes, weights: Nodes) -> tuple[Nodes, Nodes]:
    """Return nodes within the prior of an input, and the prior's mass that each stands for."""
    low, high = float(SPACE.low[column]), float(SPACE.high[column])
    begin, end = max(mean - WIDE * sd, low), min(mean + WIDE * sd, high)
    share = 0.5 * max(end - begin, 0.0) / (high - low)
    return begin + 0.5 * (places + 1) * (end - begin), share * weights


def against_quadrature(nodes: int, folder: Path) -> tuple[Table, list[str]]:
    """Return the table of ln B for one, two and three rates, and the aims that are missed."""
    rows, missed = [], []
    for rates in RATES:
        seen = data(rates, folder)
        studies = [study(law, rates, folder) for law in LAWS]
        posteriors = [sl.run_study(one).calibration.posterior for one in studies]
        found = sl.compare(studies, to=folder / f"{len(rates)}-rates" / "comparison")
        pairs = zip(LAWS, posteriors, strict=True)
        exact, failed = zip(*(by_quadrature(law, rates, seen, one, nodes, folder) for law, one in pairs), strict=True)
        (factor,) = found.found.models.factors
        ln = factor.ln if factor.of == LAWS[0] else -factor.ln
        runs = [one["runs"] for one in found.content["models"].values()]
        rates_shown = " + ".join(f"{rate:g}" for rate in rates.values())
        rows.append((rates_shown, *runs, ln, factor.error, exact[0] - exact[1], factor.words, *failed))
        print(rows[-1], flush=True)
        if abs(ln - (exact[0] - exact[1])) > WITHIN:
            missed.append(f"{rates_shown} mm²/s: ln B is {ln:.2f}, by quadrature {exact[0] - exact[1]:.2f}")
        if factor.decided and abs(factor.ln) < 1:
            missed.append(f"{rates_shown} mm²/s: a winner with ln B = {factor.ln:.2f}")
    heading = (
        "rates, mm²/s | runs, SVK {d} | runs, NH {d} | ln B {.2f} | error {.2f} | by quadrature {.2f} | verdict "
        "| failed runs, SVK {d} | failed runs, NH {d}"
    )
    return table("compare-quadrature", "ln B of Saint-Venant–Kirchhoff over neo-Hookean", heading, rows), missed


class Crossing(NamedTuple):
    """Number of the right law, ln B of it over the other one, whether one is preferred, and inputs inside intervals.

    The 90 % intervals are those averaged over the laws, those under the right law alone, and those under the other one.
    """

    law: int
    ln: float
    decided: bool
    averaged: np.ndarray
    right: np.ndarray
    wrong: np.ndarray


def crossings(number: int, folder: Path) -> list[Crossing]:
    """Return crossings with all three rates, the law of each in turn."""
    rates, x = RATES[-1], SPACE.to_physical(sobol(DESIGN, 2, scramble=2))
    learnt = []
    for law in LAWS:
        records = runs_of(law, rates, x, folder)
        some = next(record for record in records if record.ok).interfaces
        # the observation only sets the accuracy that the surrogate needs
        seen = tuple(sl.Observation(one, sl.PointErrors(SD), name) for name, one in some.items())
        with one_thread():
            learnt.append(learn(x, records, SPACE, seen, sl.NormalOffset()))
    random, found = np.random.default_rng(21), []
    while len(found) < number:
        law, truth = len(found) % 2, SPACE.prior_quantiles(random.random((1, 2)))
        (run,) = runs_of(LAWS[law], rates, truth, folder)
        if not run.ok:
            continue  # no interface to be observed
        errors = sl.PointErrors(SD)
        seen = tuple(sl.Observation(errors.draw(run.interfaces[name], random), errors, name) for name in rates)
        known = [replace(k, likelihood=FieldLikelihood(k.surrogate, seen, sl.NormalOffset())) for k in learnt]
        found.append(_crossing(law, truth[0], known, random))
        one = found[-1]
        print(LAWS[law], truth[0].round(2), f"ln B {one.ln:.2f}", one.averaged, one.right, one.wrong, flush=True)
    return found


def _crossing(
    law: int, truth: Float[np.ndarray, " 2"], known: Sequence[Knowledge], random: np.random.Generator
) -> Crossing:
    with one_thread():
        x = SPACE.prior_quantiles(sobol(ROUGH, 2, scramble=5))
        pools = [integrated(k, SPACE, Weighted(x, np.asarray(softmax(k.plug_in(x)))), random) for k in known]
        evidences = [evidence_of(k, pool, random) for k, pool in zip(known, pools, strict=True)]
    compared = ModelComparison(dict(zip(LAWS, evidences, strict=True)))
    posteriors = [pool.weighted for pool in pools]
    together = averaged(posteriors, [compared.probabilities[name] for name in LAWS])
    ln, decided = evidences[law].log - evidences[1 - law].log, compared.favoured is not None
    inside = (holds(one, truth) for one in (together, posteriors[law], posteriors[1 - law]))
    return Crossing(law, ln, decided, *inside)


def holds(posterior: Weighted, truth: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " 2"]:
    """Return which inputs the central 90 % intervals contain, 1 or 0."""
    below = posterior.weights @ (posterior.draws < truth)
    return np.asarray((below >= 0.05) & (below <= 0.95), float)


def _of_crossings(found: Sequence[Crossing]) -> tuple[Table, list[str]]:
    of_law = [[one for one in found if one.law == k] for k in range(2)]
    rows, missed = [], []
    for name, some in zip(("Saint-Venant–Kirchhoff", "neo-Hookean", "both"), (*of_law, found), strict=True):
        cover = [100 * np.mean([getattr(one, kind) for one in some], axis=0) for kind in ("averaged", "right", "wrong")]
        right = sum(one.decided and one.ln > 0 for one in some)
        wrong = sum(one.decided and one.ln < 0 for one in some)
        rows.append((name, len(some), *(float(share) for pair in cover for share in pair), right, wrong))
    for k, name in enumerate(("E", "ν")):
        if rows[-1][2 + k] < 100 * COVERED:
            missed.append(f"averaged intervals of {name} contain the truth in {rows[-1][2 + k]:.0f} %")
    if any(one.decided and abs(one.ln) < 1 for one in found):
        missed.append("a winner below 1 nat")
    heading = (
        "right law | crossings {d} | averaged: E, % {.0f} | ν, % {.0f} | right law: E, % {.0f} | ν, % {.0f} "
        "| wrong law: E, % {.0f} | ν, % {.0f} | right winners {d} | wrong winners {d}"
    )
    return table("compare-crossings", "Averaged intervals that contain the truth", heading, rows), missed


def _main() -> None:
    options = arguments(__doc__, nodes=12, crossings=40, folder=Path, publish=False)
    use_double()
    made = []
    with kept_or_scratch(options.folder) as folder:
        if options.nodes:
            made.append(against_quadrature(options.nodes, folder))
        if options.crossings:
            made.append(_of_crossings(crossings(options.crossings, folder)))
    tables = [table for table, _ in made]
    show(tables, page=PAGE if options.publish else None, numbers="comparison.json")
    finish(said for _, missed in made for said in missed)


if __name__ == "__main__":
    _main()
