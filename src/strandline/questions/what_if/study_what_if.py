"""How the posterior of a finished study changes with other assumptions, without a forward run."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from strandline.calibration import Observer
from strandline.calibration.alternative import Alternative, Present, present
from strandline.calibration.in_notebook import observer_or_default
from strandline.calibration.usual_alternatives import usual_alternatives
from strandline.calibration.what_if import Answer, answered
from strandline.design.active import Knowledge
from strandline.errors import InvalidInput, InvalidStudy, TooFewRuns
from strandline.numerics.threads import one_thread, use_double
from strandline.questions.arguments import require_seed
from strandline.questions.knowledge import field_knowledge
from strandline.questions.shown import figures_of, html_answer, input_label
from strandline.questions.what_if.alternatives import alternative_of, asked_in, require_asked
from strandline.questions.what_if.results import describe_what_if, in_order
from strandline.report import write_answer
from strandline.report.answers import draw_what_if
from strandline.runs import Progress
from strandline.studies.check import finished_posterior
from strandline.studies.folder import WHAT_IF, require_writable, told_if_unwritable, write_json
from strandline.studies.keys.study_file import WhatIf
from strandline.studies.study import Study

__all__ = ["StudyWhatIf", "what_if"]


@dataclass(frozen=True)
class StudyWhatIf:
    """How the posterior of a study changes with other assumptions.

    Args:
        content: Content of what-if.json.
        answers: The posterior under each alternative; those that move come first.
        page: Path of what-if.html.
    """

    content: dict[str, Any]
    answers: tuple[Answer, ...]
    page: Path

    def __repr__(self) -> str:
        return f"<StudyWhatIf of {self.content['study']}: {self.content['conclusion']}>"

    def _repr_html_(self) -> str:
        inputs = self.content["present"]["inputs"]
        head = [
            f"{input_label(name, item)}: {what}" for name, item in inputs.items() for what in ("shift/sd", "sd ratio")
        ]
        rows = []
        for one in self.content["alternatives"]:
            known = [one["inputs"].get(name) for name in inputs]
            cells = [f"{item[key]:.2f}" if item else "–" for item in known for key in ("shift", "sd_ratio")]
            rows.append((one["name"], *cells))
        return html_answer(self.content["conclusion"], ("other assumption", *head), rows)

    @property
    def figures(self) -> dict[str, Figure]:
        """The figure of what-if.html by name."""
        return figures_of(draw_what_if(self.content))


def what_if(
    study: Study,
    alternatives: Sequence[Mapping[str, Any]] | None = None,
    *,
    seed: int = 1,
    observer: Observer | None = None,
) -> StudyWhatIf:
    """Return how the posterior of a finished study changes with its assumptions, without a forward run.

    Writes what-if.json, what-if.html and a figure.

    Args:
        study: A finished study, from `load_study`.
        alternatives: Other assumptions, each with the keys of `what_if` in study.yaml; by default those of study.yaml
            and the usual ones.
        seed: Seed of all random numbers, 0 or above.
        observer: Receives the progress.

    Raises:
        InvalidInput: A negative seed, or an empty list of alternatives.
        InvalidStudy: The study is not finished, its folder cannot be written to, or an alternative does not fit it.
        LedgerError: The ledger is damaged, or belongs to another model.
    """
    require_seed(seed, "what-if")
    if alternatives is not None and not alternatives:
        raise InvalidInput(
            "alternatives", value="none", expected="at least one", remedy="Leave them out to ask the usual questions."
        )
    asked = asked_in(study) if alternatives is None else tuple(require_asked(one) for one in alternatives)
    posterior = finished_posterior(study, purpose="compare with")
    require_writable(study.folder)
    use_double()
    tell = observer_or_default(observer)
    with one_thread():
        tell.stage("surrogate")
        knowledge, why_not = _known(study)
        now = present(posterior, knowledge, why_not=why_not)
        tried = list(_alternatives(study, now, asked, usual=alternatives is None))
        tell.stage("alternatives")
        answers = in_order(tuple(_answers(now, tried, seed, tell)))
    tell.stage("report")
    content = describe_what_if(study, now, answers, seed=seed)
    with told_if_unwritable(study.folder):
        page = write_answer("what-if", content, study.folder, draft=study.settings.draft)
        write_json(study.folder / WHAT_IF, content)
    return StudyWhatIf(content, answers, page)


def _known(study: Study) -> tuple[Knowledge | None, str]:
    """Return the surrogate of the interface with the study's likelihood, or why there is none."""
    try:
        return field_knowledge(study, next(iter(study.discrepancies)), purpose="what-if"), ""
    except (InvalidStudy, TooFewRuns) as error:
        return None, f"there is no surrogate of the interface ({error.value})"


def _alternatives(study: Study, now: Present, asked: Sequence[WhatIf], *, usual: bool) -> Iterator[Alternative]:
    """Yield the alternatives that are asked for, then the usual ones."""
    for one in asked:
        yield alternative_of(one, study, now)
    if usual:
        yield from usual_alternatives(now, study.discrepancies)


def _answers(now: Present, tried: Sequence[Alternative], seed: int, tell: Observer) -> Iterator[Answer]:
    begun = time.monotonic()
    for number, one in enumerate(tried, start=1):
        yield answered(now, one, seed=seed)
        tell.part(Progress(len(tried), number, number, 0, 0, time.monotonic() - begun))
