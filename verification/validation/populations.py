"""Many biofilms and one set of runs: time, agreement with full analyses, and coverage of the population's intervals.

The true model makes all outlines, with errors of 3 µm at each point. One study of 100 runs analyses them all.

    python -m verification.validation.populations [--folder FOLDER] [--specimens 1000] [--checked 50] [--populations 40]

- 1000 specimens of one population, E ~ N(400, 40) Pa and ν ~ N(0.2, 0.08): seconds for all posteriors.
- 50 of them again, each by an analysis of its own: another design of 128 runs, its own surrogate, tempering.
- 40 populations of 25 specimens, with means and spreads drawn at random: how often 90 % intervals contain them.

The folder keeps the runs, so that a second call makes none.
"""

import time
from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from verification.validation.tables import DOCS, arguments, show, table

import strandline as sl
from strandline.questions.many import Task, posteriors_of
from strandline.questions.opened import Specimens
from strandline.questions.population import population_of, shrunk
from strandline.questions.specimen import SpecimenPosterior

PAGE = DOCS / "results" / "accuracy.md"
STUDY = """\
version: 1
name: many-biofilms
model: {biofilm: {mesh: coarse}}
fixed: {V_in: 100}
inputs:
  E:  {prior: {uniform: [100, 800]}, unit: Pa}
  nu: {prior: {uniform: [-0.8, 0.5]}}
observation: {synthetic: {E: 400, nu: 0.3, V_in: 100}, noise: {sd: 0.003}}
discrepancy: {normal_offset: {}}
noise: {sd: 3, unit: um}
design: {sobol: {runs: 100, scramble: 1}}
surrogate: {field: {}}
executor: {local: {timeout: 120}}
"""
ERRORS = sl.PointErrors(0.003)
MEAN, SPREAD = np.array([400.0, 0.2]), np.array([40.0, 0.08])
LOWEST, HIGHEST = np.array([[300.0, 0.0], [20.0, 0.03]]), np.array([[500.0, 0.25], [60.0, 0.1]])
"""Range of the populations' means and spreads, of E and of ν."""
OF_EACH = 25
OTHER_RUNS = 128


def outlines(study: sl.Study, inputs: Float[np.ndarray, "run 2"], ledger: Path, seed: int) -> list[sl.Interface | None]:
    """Return outlines of the true model with errors; None for a run that failed."""
    wanted = [{**study.fixed, **study.space.as_mapping(x)} for x in np.clip(inputs, study.space.low, study.space.high)]
    with sl.Ledger.open(ledger, model=study.runs.identity, description="specimens") as opened:
        records = sl.run_campaign(study.model, wanted, ledger=opened, executor=study.executor)
    return [
        ERRORS.draw(record.interfaces[""], np.random.default_rng([seed, k])) if record.ok else None
        for k, record in enumerate(records)
    ]


def answered(opened: Specimens, seen: Sequence[sl.Interface | None]) -> list[SpecimenPosterior]:
    """Return the posteriors of all outlines, in the order of their names."""
    tasks = [Task(f"{k:04}", (sl.Observation(one, ERRORS),), {}) for k, one in enumerate(seen) if one is not None]
    found = posteriors_of(opened.begin, sl.NormalOffset(), tasks)
    return sorted((one for one in found if isinstance(one, SpecimenPosterior)), key=lambda one: one.name)


def full(study: sl.Study, seen: sl.Interface, ledger: Path) -> sl.Posterior:
    """Return the posterior by an analysis of one outline, from runs of another design."""
    observations, measures = (sl.Observation(seen, ERRORS),), {"offset": sl.NormalOffset()}
    problem = sl.Problem(study.model, study.space, study.fixed, observations, measures)
    settings = sl.Settings(runs=OTHER_RUNS, scramble=2, surrogate="field")
    return sl.calibrate(problem, settings, ledger=ledger, executor=study.executor).posterior


def populations(study: sl.Study, opened: Specimens, number: int, folder: Path) -> tuple[list[int], float]:
    """Return how many of the population's intervals contain the truth, and what share of the shrunk ones do."""
    random, counts, inside = np.random.default_rng(5), np.zeros(4, int), []
    for k in range(number):
        mean, spread = LOWEST + (HIGHEST - LOWEST) * random.random((2, 2))
        truths = mean + spread * random.standard_normal((OF_EACH, 2))
        truths = np.clip(truths, study.space.low, study.space.high)
        seen = outlines(study, truths, folder / "populations.sqlite", 100 + k)
        found = answered(opened, seen)
        population = population_of(found)
        low, high = np.quantile(np.hstack([population.mean, population.sd]), [0.05, 0.95], axis=0)
        counts += (low <= np.hstack([mean, spread])) & (np.hstack([mean, spread]) <= high)
        lifted = shrunk(population, tuple(one.name for one in found))
        known = truths[[int(one.name) for one in found]]
        inside.append((lifted.quantiles[:, 0] <= known) & (known <= lifted.quantiles[:, 2]))
    return counts.tolist(), float(np.concatenate(inside).mean())


def _rows(options: Namespace, folder: Path) -> Iterator[tuple[str, str, str]]:
    (folder / "study.yaml").write_text(STUDY, encoding="utf-8")
    study = sl.load_study(folder)
    if not (folder / "posterior.nc").is_file():
        sl.run_study(study)
    opened = sl.open_specimens(study)
    runs = opened.begin.knowledge.surrogate.runs
    truths = MEAN + SPREAD * np.random.default_rng(7).standard_normal((options.specimens, 2))
    seen = outlines(study, truths, folder / "specimens-true.sqlite", 11)
    begun = time.perf_counter()
    found = answered(opened, seen)
    seconds = time.perf_counter() - begun
    good = sum(one.certified.good for one in found)
    yield f"posteriors of {len(found)} outlines from {runs} runs", "≤ 60 s", f"{seconds:.0f} s, {good} good"
    begun = time.perf_counter()
    for one in seen[:5]:
        opened.posterior(one)
    yield "one more outline, warm", "< 1 s", f"{(time.perf_counter() - begun) / 5:.2f} s"
    shifts, ratios = [], []
    for one in found[:: max(len(found) // options.checked, 1)][: options.checked]:
        other = full(study, seen[int(one.name)], folder / "others.sqlite")
        shifts.append(np.abs(one.mean - other.mean) / other.sd)
        ratios.append(one.sd / other.sd)
    worst, ratio = np.max(shifts), np.array(ratios)
    text = f"{worst:.3f} sd at most, median {np.median(shifts):.3f}; sd ratio {ratio.min():.2f} to {ratio.max():.2f}"
    yield f"{len(shifts)} posterior means against full analyses", "≤ 0.1 sd", text
    counts, inside = populations(study, opened, options.populations, folder)
    names = ("mean of E", "mean of ν", "spread of E", "spread of ν")
    of = [f"{name} {100 * count / options.populations:.0f} %" for name, count in zip(names, counts, strict=True)]
    share = 100 * sum(counts) / (4 * options.populations)
    aim = f"90 % intervals of {options.populations} populations of {OF_EACH}"
    yield aim, "85 to 95 %", f"{share:.0f} % ({', '.join(of)})"
    yield "90 % shrunk intervals of their specimens", "", f"{100 * inside:.0f} %"


if __name__ == "__main__":
    chosen = arguments(__doc__, folder=Path("populations"), specimens=1000, checked=50, populations=40, publish=False)
    chosen.folder.mkdir(parents=True, exist_ok=True)
    found = table("populations", "Many biofilms", "what | aim | found", _rows(chosen, chosen.folder), live=True)
    show([found], page=PAGE if chosen.publish else None)
