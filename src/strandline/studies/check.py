"""Check of a finished study's posterior with the true model, by runs at some of its draws.

These runs have their own ledger, check.sqlite: the design's ledger stays the same to the byte, and each of the two can
be locked, deleted or reused without the other.
"""

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.calibration import Observer
from strandline.calibration.in_notebook import observer_or_default
from strandline.discrepancy import oriented_like_runs
from strandline.errors import InvalidInput, InvalidStudy, TooFewRuns
from strandline.interface import Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models.protocol import ForwardModel
from strandline.posterior import Posterior, from_datatree, read, reweight, subset
from strandline.report import add_check
from strandline.runs import Executor, Ledger, RunRecord, run_campaign, run_key
from strandline.studies.check_file import Compared, describe
from strandline.studies.folder import CHECK, CHECK_LEDGER, POSTERIOR, require_writable, told_if_unwritable, write_json
from strandline.studies.noise import require_stated
from strandline.studies.observed import noisy
from strandline.studies.progress import results_of
from strandline.studies.study import Study
from strandline.studies.study_runs import settled

__all__ = ["PosteriorCheck", "check_posterior", "finished_posterior", "plain_model"]

FEWEST_DRAWS = 20


@dataclass(frozen=True)
class PosteriorCheck:
    """The content of check.json, and its path."""

    content: dict[str, Any]
    path: Path


def check_posterior(
    study: Study, *, draws: int = 200, executor: Executor | None = None, observer: Observer | None = None
) -> PosteriorCheck:
    """Run the true model at draws of the study's posterior, and reweight the draws by its likelihood.

    The draws depend only on the posterior, the seed and their number, and the runs are kept: no run is made twice.
    Writes check.json, figures/check.png and .pdf, and a section of report.html.

    Args:
        study: A finished study, from `load_study`.
        draws: Number of draws; at least 20, at most as many as there are particles.
        executor: Where forward runs are made; by default where the study says.
        observer: Receives the progress.

    Raises:
        InvalidInput: `draws` is too small or too large.
        InvalidStudy: The study has no results for its present study.yaml, or its folder cannot be written to.
        LedgerError: The ledger is locked, belongs to another model, or is damaged.
        TooFewRuns: The run failed at every draw.
    """
    _require_number(draws, None)
    posterior = finished_posterior(study)
    _require_number(draws, posterior.number)
    require_writable(study.folder)
    tell, begun = observer_or_default(observer), time.perf_counter()
    observations = _observations(study)
    require_stated((seen.noise for seen in observations), "strandline posterior check")
    chosen = subset(posterior.weights, draws, study.settings.seed)
    positions, surrogate = posterior.draws[chosen], posterior.log_likelihood[chosen]
    tell.stage("draws")
    records, new_runs = _run(study, positions, executor or study.executor, tell)
    tell.stage("report")
    observations = tuple(_oriented(seen, records) for seen in observations)
    likelihood = InterfaceLikelihood(observations, next(iter(study.discrepancies.values())))
    true = np.array([likelihood(record.interfaces) if record.ok else -np.inf for record in records])
    _require_one(records)
    found = Compared(posterior, chosen, records, true, surrogate, reweight(positions, true - surrogate))
    content = describe(study, found, observations, new_runs=new_runs)
    with told_if_unwritable(study.folder):
        add_check(content, study.folder, draft=study.settings.draft)
        content["seconds"] = time.perf_counter() - begun
        write_json(study.folder / CHECK, content)
    return PosteriorCheck(content, study.folder / CHECK)


def finished_posterior(study: Study, *, purpose: str = "check") -> Posterior:
    """Return the posterior of a study that has results for its present study.yaml.

    Args:
        study: The study.
        purpose: What the posterior is needed for, a verb for the message.

    Raises:
        InvalidStudy: The study has no such posterior, or it cannot be read.
    """
    results, path = results_of(study), study.folder / POSTERIOR
    if results != "current" or not path.is_file():
        outdated = results == "outdated"
        raise InvalidStudy(
            f"the study has no posterior to {purpose}",
            value="results of an earlier study.yaml" if outdated else "a study that is not finished",
            expected=f"{POSTERIOR}, made from study.yaml as it is",
            remedy=f"Run it first: strandline run {study.folder}",
        )
    study.runs.require_finished()
    try:
        return from_datatree(read(path), study.space)
    except (OSError, KeyError, ValueError) as error:
        raise InvalidStudy(
            f"{POSTERIOR} cannot be read",
            value=str(error),
            expected="the posterior of this study",
            remedy=f"Make it again: strandline report {study.folder}",
        ) from error


def _observations(study: Study) -> tuple[Observation, ...]:
    """Return the observations behind the posterior; a synthetic one is a run in the study's ledger plus noise."""
    observed = study.observed
    if study.truth is not None:
        identity = study.runs.identity
        key = run_key(identity, study.truth)
        with Ledger.open(study.ledger_path, model=identity, read_only=True) as ledger:
            observed = noisy(ledger.latest([key])[key].interfaces, study.synthetic_noise)
    return study.observations(observed)


def _oriented(seen: Observation, records: Sequence[RunRecord]) -> Observation:
    """Return the observation with its points in the same direction as those of the runs."""
    runs = [record.interfaces[seen.condition] for record in records if record.ok]
    return seen.reversed() if oriented_like_runs(seen.interface, runs).flipped else seen


def _run(
    study: Study, positions: Float[np.ndarray, "draw dim"], executor: Executor, observer: Observer
) -> tuple[tuple[RunRecord, ...], int]:
    """Return the record of each draw, and the number of new runs."""
    model, identity = plain_model(study), study.runs.identity
    inputs = [{**study.fixed, **study.space.as_mapping(x)} for x in positions]
    keys = {run_key(identity, entry) for entry in inputs}
    with Ledger.open(study.folder / CHECK_LEDGER, model=identity, description=f"{study.name}, checked") as ledger:
        known = len(settled(ledger, keys))
        records = run_campaign(model, inputs, ledger=ledger, executor=executor, on_record=observer.run)
    return records, len(keys) - known


def plain_model(study: Study) -> ForwardModel:
    """Return the model without sensitivities, which are not needed here."""
    model: Any = study.model
    plain: ForwardModel = dataclasses.replace(model, sensitivities=False) if study.sensitivities else model
    return plain


def _require_number(draws: int, particles: int | None) -> None:
    if draws < FEWEST_DRAWS or (particles is not None and draws > particles):
        most = "the number of particles" if particles is None else f"{particles}, the number of particles"
        raise InvalidInput(
            "draws of the check",
            value=draws,
            expected=f"from {FEWEST_DRAWS} to {most}",
            remedy="200 are a good start; more draws make k̂ more certain.",
        )


def _require_one(records: tuple[RunRecord, ...]) -> None:
    if not any(record.ok for record in records):
        first = records[0]
        raise TooFewRuns(
            "the true model failed at every draw of the posterior",
            value=f"0 of {len(records)}; e.g. {first.failure_kind or first.state}: "
            + (first.message or "no message").splitlines()[0],
            expected="a posterior where the simulator runs",
            remedy="Look at the failures; the surrogate knows nothing of where the posterior lies.",
        )
