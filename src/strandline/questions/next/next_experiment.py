"""Which experiment to make next: candidates of a study ranked by what they can be expected to teach."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from strandline.calibration import Observer
from strandline.calibration.in_notebook import observer_or_default
from strandline.errors import InvalidInput, InvalidStudy
from strandline.numerics.threads import one_thread, use_double
from strandline.planning.candidate import Candidate
from strandline.questions.arguments import require_seed
from strandline.questions.next.answers import Answers
from strandline.questions.next.from_posterior import answers_from_posterior
from strandline.questions.next.from_prior import answers_from_prior
from strandline.questions.next.results import describe_next
from strandline.questions.shown import figures_of, html_answer, input_label
from strandline.report import write_answer
from strandline.report.answers import draw_next
from strandline.runs import Executor
from strandline.studies.check import finished_posterior
from strandline.studies.folder import NEXT, POSTERIOR, require_writable, told_if_unwritable, write_json
from strandline.studies.progress import results_of
from strandline.studies.study import Study

__all__ = ["NextExperiment", "next_experiment"]

SOURCES = ("prior", "posterior")
FEWEST_RUNS, FEWEST_DRAWS, MOST_DRAWS = 4, 200, 4000


@dataclass(frozen=True)
class NextExperiment:
    """What each candidate for the next experiment can be expected to teach.

    Args:
        content: Content of next.json.
        found: The answers, with arrays.
        page: Path of next.html.
    """

    content: dict[str, Any]
    found: Answers
    page: Path

    def __repr__(self) -> str:
        return f"<NextExperiment after {self.content['study']}: {self.content['advice']}>"

    def _repr_html_(self) -> str:
        inputs = self.content["inputs"]
        ratios = [f"sd of {input_label(name, item)}, share of now" for name, item in inputs.items()]
        rows = [
            (
                one["label"],
                f"{one['gain']:.2f} ± {one['error']:.2f}",
                *(f"{one['sd_ratio'][name]:.2f}" for name in inputs),
            )
            for one in self.content["candidates"]
            if one["gain"] is not None
        ]
        return html_answer(self.content["advice"], ("experiment", "gain [nats]", *ratios), rows)

    @property
    def figures(self) -> dict[str, Figure]:
        """The figures of next.html by name."""
        return figures_of(draw_next(self.content))


def next_experiment(
    study: Study,
    *,
    source: str | None = None,
    draws: int = 1000,
    runs: int = 8,
    seed: int = 1,
    executor: Executor | None = None,
    observer: Observer | None = None,
) -> NextExperiment:
    """Rank the candidates that study.yaml lists under `next` by what they can be expected to teach.

    After an experiment, each candidate that the surrogate of the interface does not cover costs one run with
    sensitivities, or one run for each input and one more without; the gains come from nested Monte Carlo. Before any
    data, each candidate is run at a few draws of the prior, and the gains are linearised. Runs go to next.sqlite and
    are not made again. Writes next.json, next.html and its figures.

    Args:
        study: The study, from `load_study`.
        source: Where to begin: from the ``posterior`` of a finished study, or from the ``prior``; by default the
            posterior if there is one.
        draws: Number of draws of the posterior, from 200 to 4000.
        runs: Number of draws of the prior at which each candidate is run, at least 4.
        seed: Seed of all random numbers, 0 or above.
        executor: Where runs are made; the study's by default.
        observer: Receives the progress.

    Raises:
        InvalidInput: An argument is out of its range, no errors of the points have the stated σ_N², or a part of the
            interface has too few points.
        InvalidStudy: The study has no posterior to plan from, lists no candidates, or its folder cannot be written to.
        LedgerError: A ledger is locked, damaged, or belongs to another model.
        TooFewRuns: The planned experiment failed at every draw of the prior.
    """
    _require_arguments(source, draws, runs, seed)
    begun, tell = time.perf_counter(), observer_or_default(observer)
    executor = executor or study.executor
    after = source == "posterior" or (source is None and _has_posterior(study))
    if source == "posterior":
        finished_posterior(study, purpose="plan from")
    candidates = _candidates(study, after=after)
    require_writable(study.folder)
    use_double()
    with one_thread():
        if after:
            found = answers_from_posterior(study, candidates, draws=draws, seed=seed, executor=executor, observer=tell)
        else:
            found = answers_from_prior(study, candidates, runs=runs, executor=executor, observer=tell)
    tell.stage("report")
    content = describe_next(study, found, seed=seed, seconds=time.perf_counter() - begun)
    with told_if_unwritable(study.folder):
        page = write_answer("next", content, study.folder, draft=study.settings.draft)
        write_json(study.folder / NEXT, content)
    return NextExperiment(content, found, page)


def _has_posterior(study: Study) -> bool:
    return results_of(study) == "current" and (study.folder / POSTERIOR).is_file()


def _candidates(study: Study, *, after: bool) -> tuple[Candidate, ...]:
    """Return the candidates; before any data there may be none, since the planned experiment is one."""
    if study.candidates or not after:
        return study.candidates
    known = next(iter(study.fixed), None)
    raise InvalidStudy(
        "study.yaml lists no candidates for the next experiment",
        value=None,
        expected=f"e.g. `next: {{{known}: [{study.fixed[known]:g}, {2 * study.fixed[known]:g}]}}`"
        if known
        else "e.g. `next: {part: [[0, 0.5], [0.5, 1]]}`",
        remedy="Add them; the results of the study stay as they are.",
    )


def _require_arguments(source: str | None, draws: int, runs: int, seed: int) -> None:
    if source is not None and source not in SOURCES:
        raise InvalidInput(
            "source of the next experiment", value=source, expected=" or ".join(SOURCES), remedy="Choose one of them."
        )
    if not FEWEST_DRAWS <= draws <= MOST_DRAWS:
        raise InvalidInput(
            "draws of the posterior",
            value=draws,
            expected=f"from {FEWEST_DRAWS} to {MOST_DRAWS}",
            remedy="1000 are a good start; more make the gains more certain.",
        )
    if runs < FEWEST_RUNS:
        raise InvalidInput(
            "runs of each candidate",
            value=runs,
            expected=f"at least {FEWEST_RUNS}",
            remedy="8 are a good start.",
        )
    require_seed(seed, "the next experiment")
