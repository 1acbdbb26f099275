"""Which model do the data prefer? Finished studies of the same data, compared without a run."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from strandline.calibration import Observer
from strandline.calibration.evidence import Evidence, log_evidence
from strandline.calibration.in_notebook import observer_or_default
from strandline.calibration.model_comparison import ModelComparison, averaged, require_odds
from strandline.design.active import Knowledge
from strandline.errors import InvalidInput, InvalidStudy
from strandline.numerics.threads import one_thread, use_double
from strandline.parameters import ParameterSpace
from strandline.planning.discrimination import Discrimination, expected_discrimination
from strandline.posterior import Posterior
from strandline.posterior.weighted import Weighted
from strandline.priors import Uniform
from strandline.questions.arguments import require_seed
from strandline.questions.compare.comparable import labels_of, may_err, require_comparable, require_several
from strandline.questions.compare.results import Compared, describe_comparison, not_flat
from strandline.questions.compare.separation import Shown, candidates_of, require_settable, shown_by_models
from strandline.questions.knowledge import field_knowledge
from strandline.questions.shown import figures_of, html_answer
from strandline.report import write_answer
from strandline.report.answers import draw_comparison
from strandline.runs import Executor
from strandline.studies.check import finished_posterior
from strandline.studies.first_run import observations_of
from strandline.studies.folder import COMPARISON, STUDY, SUMMARY, require_writable, told_if_unwritable, write_json
from strandline.studies.study import Study, load_study

__all__ = ["FOLDER", "StudyComparison", "compare", "odds_in"]

FOLDER = "comparison"
"""Folder that holds the result, in the current one."""


@dataclass(frozen=True)
class StudyComparison:
    """Which model the data prefer.

    Args:
        content: Content of compare.json.
        found: Evidences, Bayes factors and probabilities of the models.
        shared: Names of the inputs that all models share.
        averaged: Draws of these inputs, averaged over the models; None if there are none.
        page: Path of compare.html.
    """

    content: dict[str, Any]
    found: ModelComparison
    shared: tuple[str, ...]
    averaged: Weighted | None
    page: Path

    def __repr__(self) -> str:
        return f"<StudyComparison of {', '.join(self.found.evidences)}: {self.content['verdict']}>"

    def _repr_html_(self) -> str:
        rows = [
            (name, f"{one['log_evidence']:.2f} ± {one['error']:.2f}", f"{one['probability']:.3g}", str(one["runs"]))
            for name, one in self.content["models"].items()
        ]
        return html_answer(self.content["verdict"], ("model", "log-evidence", "probability", "runs"), rows)

    @property
    def figures(self) -> dict[str, Figure]:
        """The figures of compare.html by name."""
        return figures_of(draw_comparison(self.content))


def compare(
    studies: Sequence[Study | Path | str],
    *,
    to: Path | str = FOLDER,
    odds: Sequence[float] | None = None,
    seed: int = 1,
    separate: bool = False,
    executor: Executor | None = None,
    observer: Observer | None = None,
) -> StudyComparison:
    """Compare finished studies of the same data: evidences, Bayes factors, predictions, and the averaged posterior.

    The interface is learnt from the runs of each study; only `separate` makes forward runs. Writes compare.json,
    compare.html and its figures.

    Args:
        studies: Two or more studies, or their folders.
        to: Folder of the result, created if needed.
        odds: Prior probabilities of the models relative to each other, in the order of the studies; equal by default.
        seed: Seed of all random numbers, 0 or above.
        separate: Whether to predict how well the candidates for the next experiment, listed under `next` of the first
            study that lists some, would tell the models apart. Those that a surrogate does not cover cost one run with
            sensitivities of each model.
        executor: Where these runs are made; by default where each study says.
        observer: Receives the progress.

    Raises:
        InvalidInput: Fewer than two studies, the same one twice, or wrong odds or seed.
        InvalidStudy: A study is not finished, the studies explain other data or assume other noise or supports of
            priors, or the folder cannot be used.
        LedgerError: A ledger is damaged, or belongs to another model.
        TooFewRuns: Too few runs of a study succeeded to learn the interface.
    """
    loaded = [one if isinstance(one, Study) else load_study(one) for one in studies]
    named = _named(loaded, odds)
    require_seed(seed, "the comparison")
    wanted = candidates_of(loaded) if separate else ()
    require_settable(named, wanted)
    posteriors = {name: finished_posterior(study, purpose="compare") for name, study in named.items()}
    summaries = {name: _summary(study) for name, study in named.items()}
    constants = _constants(named, summaries)
    folder = Path(to)
    _require_free(folder)
    use_double()
    tell = observer_or_default(observer)
    tell.stage("surrogate")
    compared = {
        name: Compared(study, posteriors[name], _learnt(study), summaries[name], constants[name])
        for name, study in named.items()
    }
    tell.stage("evidence")
    shared = tuple(name for name in loaded[0].space.names if all(name in one.space.names for one in loaded))
    found, widened = _found(compared, odds, seed), not_flat(compared, shared)
    flat = _found(compared, odds, seed, widened) if widened else None
    together = _together(found, posteriors, shared)
    shown = shown_by_models(named, wanted, seed=seed, executor=executor, tell=tell) if wanted else ()
    tell.stage("report")
    with one_thread():
        separations = [(one, _separation(found, one, seed)) for one in shown]
        content = describe_comparison(found, flat, compared, together, shared, separations, seed=seed)
    return StudyComparison(
        content, found, shared, together, _written(content, folder, draft=all(one.settings.draft for one in loaded))
    )


def _named(studies: Sequence[Study], odds: Sequence[float] | None) -> dict[str, Study]:
    """Return the studies by name, once they can be compared.

    Raises:
        InvalidInput: Fewer than two studies, the same one twice, or wrong odds.
        InvalidStudy: A study is not finished, or the studies explain other data.
    """
    require_several(studies)
    if odds is not None:
        require_odds(odds, len(studies))
    named = dict(zip(labels_of(studies), studies, strict=True))
    for study in studies:
        if not observations_of(study):  # synthetic, and its run is not made
            finished_posterior(study, purpose="compare")
    require_comparable(named)
    return named


def odds_in(text: str | None) -> tuple[float, ...] | None:
    """Return the numbers of prior odds such as ``2:1``; None for none.

    Raises:
        InvalidInput: The text is no such list of numbers.
    """
    if text is None:
        return None
    parts = re.split(r"[:/]", text)
    try:
        return tuple(float(part) for part in parts)
    except ValueError:
        raise InvalidInput(
            "prior odds of the models",
            value=text,
            expected="numbers above 0 with colons between them",
            remedy="Give them in the order of the studies, e.g. --odds 2:1.",
        ) from None


def _summary(study: Study) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((study.folder / SUMMARY).read_text(encoding="utf-8"))
    return found


def _constants(studies: Mapping[str, Study], summaries: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Return the constant that each study leaves out of log L; 0 for all if it is the same.

    Raises:
        InvalidStudy: Only some of the studies allow for an error of the model, and the constants are not known.
    """
    if len({may_err(study) for study in studies.values()}) == 1:
        return dict.fromkeys(studies, 0.0)
    found = {name: summary["likelihood"]["gaussian_constant"] for name, summary in summaries.items()}
    unknown = [name for name, constant in found.items() if constant is None]
    if unknown:
        raise InvalidStudy(
            "studies with and without an error of the model cannot be compared",
            value=f"a likelihood of unknown normalisation in {', '.join(unknown)}",
            expected="residuals of a fixed number, with stated errors of the points",
            remedy="Use the measure normal_offset in all studies.",
        )
    return {name: float(constant) for name, constant in found.items()}


def _require_free(folder: Path) -> None:
    """Refuse a folder that cannot hold the result; nothing is created yet.

    Raises:
        InvalidStudy: It is a study's own folder, or cannot be created or written to.
    """
    if (folder / STUDY).exists():
        raise InvalidStudy(
            "folder of the comparison",
            value=f"{folder}, which is a study",
            expected="a folder that is no study, since a comparison belongs to several",
            remedy="Choose another one, e.g. --to comparison.",
        )
    there = next(one for one in (folder, *folder.absolute().parents) if one.exists())
    if not there.is_dir():
        raise InvalidStudy(
            "folder of the comparison",
            value=f"{there}, which is a file",
            expected="a folder, or a path where one can be created",
            remedy="Choose another one, e.g. --to comparison.",
        )
    require_writable(there)


def _learnt(study: Study) -> Knowledge:
    with one_thread():
        return field_knowledge(study, next(iter(study.discrepancies)), purpose="a comparison")


def _found(
    compared: Mapping[str, Compared], odds: Sequence[float] | None, seed: int, flat: Sequence[str] = ()
) -> ModelComparison:
    """Return the comparison; the inputs `flat` have uniform priors on their boxes."""
    evidences = {name: _evidence(one, seed, flat) for name, one in compared.items()}
    return ModelComparison(evidences, None if odds is None else dict(zip(compared, odds, strict=True)))


def _evidence(one: Compared, seed: int, flat: Sequence[str]) -> Evidence:
    draws = Weighted(one.posterior.draws, one.posterior.weights)
    space = ParameterSpace(
        tuple(replace(p, prior=Uniform(*p.interval)) if p.name in flat else p for p in one.study.space)
    )
    found = log_evidence(one.knowledge, space, draws, np.random.default_rng(seed))
    return replace(found, log=found.log + one.constant)


def _together(found: ModelComparison, posteriors: Mapping[str, Posterior], shared: tuple[str, ...]) -> Weighted | None:
    """Return the posterior of the shared inputs, averaged over the models; None if they share none."""
    if not shared:
        return None
    parts = [Weighted(one.columns(shared), one.weights) for one in posteriors.values()]
    return averaged(parts, [found.probabilities[name] for name in posteriors])


def _separation(found: ModelComparison, shown: Shown, seed: int) -> Discrimination | None:
    """Return what a candidate is expected to tell about the models; hopeless ones count with a tiny probability."""
    if shown.problem:
        return None
    shares = np.maximum(list(found.probabilities.values()), 1e-12)
    return expected_discrimination(shown.signals, (shares / shares.sum()).tolist(), np.random.default_rng(seed))


def _written(content: dict[str, Any], folder: Path, *, draft: bool) -> Path:
    """Write compare.json, compare.html and its figures, in a new folder if needed; return the path of the page."""
    with told_if_unwritable(folder):
        folder.mkdir(parents=True, exist_ok=True)
        page = write_answer("compare", content, folder, draft=draft)
        write_json(folder / COMPARISON, content)
    return page
