"""Which model do the data prefer? Finished studies of the same data, compared without a run."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from strandline.calibration import (
    Evidence,
    ModelComparison,
    Observer,
    averaged,
    log_evidence,
    observer_or_default,
    require_odds,
)
from strandline.foundations import InvalidInput, InvalidStudy, one_thread, read_json, use_double
from strandline.parameters import ParameterSpace, Uniform
from strandline.posterior import Posterior, Weighted
from strandline.questions.answer import Answer, Part, Table, digits, label_and_unit
from strandline.questions.comparable import (
    CandidateSignals,
    candidates_of,
    labels_of,
    may_err,
    require_comparable,
    require_settable,
    require_several,
    shown_by_models,
)
from strandline.questions.comparison import ComparedStudy, describe_comparison, not_flat
from strandline.questions.information import Discrimination, expected_discrimination
from strandline.questions.knowledge import field_knowledge, require, require_seed
from strandline.report import Captioned, plots
from strandline.runs import Executor
from strandline.studies import STUDY, SUMMARY, Study, finished_posterior, load_study, observations_of, require_writable

__all__ = ["Comparison", "compare"]

FOLDER = "comparison"
"""Folder that holds the result, in the current one."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Which model the data prefer.

    Args:
        models: Evidences, Bayes factors and probabilities of the models.
        shared: Names of the inputs that all models share.
        averaged: Draws of these inputs, averaged over the models; None if there are none.
    """

    models: ModelComparison
    shared: tuple[str, ...]
    averaged: Weighted | None


def compare(
    studies: Sequence[Study | Path | str],
    *,
    to: Path | str = FOLDER,
    odds: Sequence[float] | None = None,
    seed: int = 1,
    separate: bool = False,
    executor: Executor | None = None,
    observer: Observer | None = None,
) -> Answer[Comparison]:
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
    summaries = {name: read_json(study.folder / SUMMARY) for name, study in named.items()}
    constants = _constants(named, summaries)
    folder = Path(to)
    _require_free(folder)
    use_double()
    tell = observer_or_default(observer)
    tell.stage("surrogate")
    with one_thread():
        known = {name: field_knowledge(study, purpose="a comparison") for name, study in named.items()}
    compared = {
        name: ComparedStudy(study, posteriors[name], known[name], summaries[name], constants[name])
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
    answer = _answer(content, Comparison(found, shared, together), folder)
    return answer.written(draft=all(one.settings.draft for one in loaded))


def _named(studies: Sequence[Study], odds: Sequence[float] | None) -> dict[str, Study]:
    """Return the studies by name, once they can be compared."""
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
    """Return the numbers of prior odds such as ``2:1``; None for none. Refuse what is no such list."""
    if text is None:
        return None
    try:
        return tuple(float(part) for part in re.split(r"[:/]", text))
    except ValueError:
        words = "numbers above 0 with colons between them", "Give them in the order of the studies, e.g. --odds 2:1."
        raise InvalidInput("prior odds of the models", value=text, expected=words[0], remedy=words[1]) from None


def _constants(studies: Mapping[str, Study], summaries: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Return the constant that each study leaves out of log L; 0 for all if it is the same."""
    if len({may_err(study) for study in studies.values()}) == 1:
        return dict.fromkeys(studies, 0.0)
    found = {name: summary["likelihood"]["gaussian_constant"] for name, summary in summaries.items()}
    unknown = [name for name, constant in found.items() if constant is None]
    require(
        not unknown,
        "studies with and without an error of the model cannot be compared",
        f"a likelihood of unknown normalisation in {', '.join(unknown)}",
        "residuals of a fixed number, with stated errors of the points",
        "Use the measure normal_offset in all studies.",
        InvalidStudy,
    )
    return found


def _require_free(folder: Path) -> None:
    """Refuse a folder that cannot hold the result; nothing is created yet."""
    there = next(one for one in (folder, *folder.absolute().parents) if one.exists())
    for wrong, value, expected in (
        ((folder / STUDY).exists(), f"{folder}, which is a study", "one that is no study: a comparison has several"),
        (not there.is_dir(), f"{there}, which is a file", "a folder, or a path where one can be created"),
    ):
        remedy = "Choose another one, e.g. --to comparison."
        require(not wrong, "folder of the comparison", value, expected, remedy, InvalidStudy)
    require_writable(there)


def _found(
    compared: Mapping[str, ComparedStudy], odds: Sequence[float] | None, seed: int, flat: Sequence[str] = ()
) -> ModelComparison:
    """Return the comparison; the inputs `flat` have uniform priors on their boxes."""
    evidences = {name: _evidence(one, seed, flat) for name, one in compared.items()}
    return ModelComparison(evidences, None if odds is None else dict(zip(compared, odds, strict=True)))


def _evidence(one: ComparedStudy, seed: int, flat: Sequence[str]) -> Evidence:
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


def _separation(found: ModelComparison, shown: CandidateSignals, seed: int) -> Discrimination | None:
    """Return what a candidate is expected to tell about the models; hopeless ones count with a tiny probability."""
    if shown.problem:
        return None
    shares = np.maximum(list(found.probabilities.values()), 1e-12)
    return expected_discrimination(shown.signals, (shares / shares.sum()).tolist(), np.random.default_rng(seed))


def _answer(content: dict[str, Any], found: Comparison, folder: Path) -> Answer[Comparison]:
    names = ", ".join(content["models"])
    return Answer(
        title=names,
        lead="Which of these models do the data prefer?",
        sentence=content["verdict"],
        remarks=content["remarks"],
        good=content["favoured"] is not None,
        parts=list(_parts(content)),
        content=content,
        found=found,
        page=folder / "compare.html",
        drawn=_drawn,
    )


def _drawn(content: Mapping[str, Any]) -> Iterator[Captioned]:
    """Yield the figure of the inputs shared by the models of compare.json, and that of predictions of polylines."""
    if content["averaged"]:
        yield Captioned.of("compare_marginals", "compare", plots.plot_averaged(content["averaged"]))
    bands = {
        (str(item["condition"]), str(name)): found
        for item in content["predictive"]
        for name, band in item["models"].items()
        if (found := plots.OffsetBand.of(band)) is not None
    }
    if bands:
        yield Captioned.of("compare_predictive", "compare", plots.plot_predictions(bands))


def _parts(content: Mapping[str, Any]) -> Iterator[Part]:
    yield _models(content)
    yield _factors(content)
    if content["averaged"]:
        yield _of_average(content["averaged"])
    verdicts = {
        name: "The fit was not judged." if one["misfit"] is None else one["misfit"]["verdict"]
        for name, one in content["models"].items()
    }
    yield Part("Does each model explain the data?", lines=[f"{name}: {said}" for name, said in verdicts.items()])
    if content["separate"]:
        yield _separate(content["separate"])
    yield Part("How it was computed", notes="how_compared")


def _models(content: Mapping[str, Any]) -> Part:
    head = "study", "inputs", "known", "log-evidence", "best log L", "information", "probability", "misfit"
    rows = [
        (
            name,
            ", ".join(one["inputs"]),
            ", ".join(f"{key} = {digits(value, 4)}" for key, value in one["fixed"].items()),
            f"{one['log_evidence']:.2f} ± {one['error']:.2f}",
            f"{one['best_log_likelihood']:.2f}",
            digits(one["information"], 3),
            f"{one['probability']:.1%}",
            "not judged"
            if one["misfit"] is None or one["misfit"]["flagged"] is None
            else "noticed"
            if one["misfit"]["flagged"]
            else "none",
        )
        for name, one in content["models"].items()
    ]
    return Part("The models", Table(head, rows), notes="compared_models")


def _factors(content: Mapping[str, Any]) -> Part:
    head = "of", "over", "ln B", "evidence", "fit", "prior", "with uniform priors"
    rows = [
        (
            one["of"],
            one["over"],
            f"{one['ln']:.2f} ± {one['error']:.2f}",
            one["words"],
            f"{one['fit']:.2f}",
            f"{one['prior']:.2f}",
            "the same" if one["flat_ln"] is None else f"{one['flat_ln']:.2f}, {one['flat_words']}",
        )
        for one in content["bayes_factors"]
    ]
    return Part("Bayes factors", Table(head, rows), notes="bayes_factors")


def _of_average(averaged: Mapping[str, Any]) -> Part:
    rows = []
    for item in averaged.values():
        for model, one in {"all models": item, **item["models"]}.items():
            figures = [digits(one[part], 4) for part in ("mean", "sd", "median", "q05", "q95")]
            rows.append((*label_and_unit(item), model, *figures))
    head = "input", "unit", "under", "mean", "sd", "median", "5 %", "95 %"
    return Part("The shared inputs, averaged over the models", Table(head, rows))


def _separate(candidates: Sequence[Mapping[str, Any]]) -> Part:
    head = "experiment", "nats about the model", "the right model wins clearly", "a wrong model wins clearly"
    rows = [
        (one["candidate"], one["problem"])
        if one["nats"] is None
        else (
            one["candidate"],
            f"{digits(one['nats'], 2)} ± {digits(one['error'], 1)}{'' if one['reliable'] else ' (few draws)'}",
            f"{one['clearly_right']:.0%}",
            f"{one['clearly_wrong']:.0%}",
        )
        for one in candidates
    ]
    return Part("Which experiment would tell them apart", Table(head, rows), notes="separate")
