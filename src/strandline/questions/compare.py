"""Which model do the data prefer? Finished studies of the same data, compared without a run.

They can be compared only if they explain the same data, with the same measure, noise and supports of priors:
log-likelihoods leave out constants, so that evidences of other data, measures or noise differ by more than the models.
What may differ is the model, its unknown and its known inputs, and whether the study allows for an error of the model.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from strandline import calibration
from strandline.foundations import InvalidInput, InvalidStudy, one_thread, read_json, require, use_double
from strandline.interface import Interface, Noise, PointErrors, UnknownErrors
from strandline.likelihood import adapted
from strandline.parameters import Uniform
from strandline.posterior import Weighted
from strandline.questions.answer import Answer
from strandline.questions.comparison import ComparedStudy, answer_of, describe_comparison, may_err, not_flat
from strandline.questions.information import Discrimination, expected_discrimination
from strandline.questions.knowledge import field_knowledge, require_seed
from strandline.questions.prospects import CandidateSignals, candidates_of, require_settable, shown_by_models
from strandline.runs import Executor
from strandline.studies import (
    STUDY,
    SUMMARY,
    Study,
    finished_posterior,
    in_words,
    load_study,
    observations_of,
    require_writable,
)

__all__ = ["Comparison", "compare"]
FOLDER = "comparison"  # folder that holds the result, in the current one


@dataclass(frozen=True, eq=False)
class Comparison:
    """Which model the data prefer.

    Args:
        models: Evidences, Bayes factors and probabilities of the models.
        shared: Names of the inputs that all models share.
        averaged: Draws of these inputs, averaged over the models; None if there are none.
    """

    models: calibration.ModelComparison
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
    observer: calibration.Observer | None = None,
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
    tell = calibration.observer_or_default(observer)
    tell.stage("surrogate")
    with one_thread():
        known = {name: field_knowledge(study, purpose="a comparison") for name, study in named.items()}
    compared = {
        name: ComparedStudy(study, posteriors[name], known[name], summaries[name], constants[name])
        for name, study in named.items()
    }
    tell.stage("evidence")
    shared = tuple(name for name in loaded[0].space.scalars if all(name in one.space.scalars for one in loaded))
    found, widened = _found(compared, odds, seed), not_flat(compared, shared)
    flat = _found(compared, odds, seed, widened) if widened else None
    parts = [Weighted(one.columns(shared), one.weights) for one in posteriors.values()]
    together = calibration.averaged(parts, [found.probabilities[name] for name in posteriors]) if shared else None
    shown = shown_by_models(named, wanted, seed=seed, executor=executor, tell=tell) if wanted else ()
    tell.stage("report")
    with one_thread():
        separations = [(one, _separation(found, one, seed)) for one in shown]
        content = describe_comparison(found, flat, compared, together, shared, separations, seed=seed)
    answer = answer_of(content, Comparison(found, shared, together), folder)
    return answer.written(draft=all(one.settings.draft for one in loaded))


def _named(studies: Sequence[Study], odds: Sequence[float] | None) -> dict[str, Study]:
    require_several(studies)
    if odds is not None:
        calibration.require_odds(odds, len(studies))
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
    what = "studies with and without an error of the model cannot be compared"
    value = f"a likelihood of unknown normalisation in {', '.join(unknown)}"
    expected = "residuals of a fixed number, with stated errors of the points"
    require(not unknown, what, value, expected, "Use the measure normal_offset in all studies.", InvalidStudy)
    return found


def _require_free(folder: Path) -> None:
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
) -> calibration.ModelComparison:
    """Return the comparison; the inputs `flat` have uniform priors on their boxes."""
    evidences = {name: _evidence(one, seed, flat) for name, one in compared.items()}
    return calibration.ModelComparison(evidences, None if odds is None else dict(zip(compared, odds, strict=True)))


def _evidence(one: ComparedStudy, seed: int, flat: Sequence[str]) -> calibration.Evidence:
    draws = Weighted(one.posterior.draws, one.posterior.weights)
    priors = tuple(replace(p, prior=Uniform(*p.interval)) if p.name in flat else p for p in one.study.space)
    space = replace(one.study.space, parameters=priors)
    found = calibration.log_evidence(one.knowledge, space, draws, np.random.default_rng(seed))
    return replace(found, log=found.log + one.constant)


def _separation(found: calibration.ModelComparison, shown: CandidateSignals, seed: int) -> Discrimination | None:
    """Return what a candidate is expected to tell about the models; hopeless ones count with a tiny probability."""
    if shown.problem:
        return None
    shares = np.maximum(list(found.probabilities.values()), 1e-12)
    return expected_discrimination(shown.signals, (shares / shares.sum()).tolist(), np.random.default_rng(seed))


SAME = 1e-6  # largest distance of points that count as the same, mm
OF_POINTS = ("sd", "length", "shift", "rotation", "scale", "offset", "shared", "shares")
DEFAULTS = {"shared": False, "shares": ()}


def require_several(studies: Sequence[Study]) -> None:
    """Refuse fewer than two studies, and the same folder twice."""
    folders = ", ".join(str(one.folder) for one in studies) or "none"
    remedy = "Name the other one too: strandline compare A B"
    require(len(studies) >= 2, "studies to compare", folders, "at least two study folders", remedy)
    seen: set[Path] = set()
    for one in studies:
        here = one.folder.resolve()
        require(here not in seen, "studies to compare", f"{one.folder} twice", "different folders")
        seen.add(here)


def labels_of(studies: Sequence[Study]) -> tuple[str, ...]:
    """Return a different name for each study: its own, or else that of its folder, or else the path."""
    folders = [one.folder.resolve() for one in studies]
    for names in ([one.name for one in studies], [one.name for one in folders]):
        if len(set(names)) == len(names):
            return tuple(names)
    return tuple(map(str, folders))


def require_comparable(studies: Mapping[str, Study]) -> None:
    """Refuse studies whose data, measure, noise or supports of shared inputs differ; the message says which."""
    (name, first), *others = studies.items()
    for one, study in studies.items():
        _require_known_range(one, study)
    for other, study in others:
        both = f"{name} and {other} cannot be compared"
        _require_same_data(both, first, study)
        _require_same_measure(both, first, study)
        _require_same_noise(both, first, study)
    for (one, study), (other, second) in combinations(studies.items(), 2):
        _require_same_supports(f"{one} and {other} cannot be compared", study, second)


def _require_same_data(both: str, first: Study, other: Study) -> None:
    seen, others = observations_of(first), observations_of(other)
    if seen.keys() != others.keys():
        value = " and ".join(", ".join(map(_condition, one)) for one in (seen, others))
        _refuse(f"{both}: they observe different conditions", value, "the same conditions in both")
    for name in seen:
        apart = _apart(seen[name], others[name])
        if not apart <= SAME:
            of = f" of {_condition(name)}" if name else ""
            value = "another number of points" if apart == np.inf else f"points up to {1e3 * apart:.3g} µm apart"
            remedy = "Give both studies the same file under observation."
            if first.truth is not None or other.truth is not None:
                where = "write it to a file with `strandline forward … --csv`, and give that to both."
                remedy = f"A synthetic observation comes from the study's own model: {where}"
            _refuse(f"{both}: the observed interfaces{of} differ", value, "the same data", remedy)


def _apart(one: Interface, other: Interface) -> float:
    """Return the largest distance of corresponding points, mm, in either direction; infinite if numbers differ."""
    if one.points.shape != other.points.shape or one.cells.shape != other.cells.shape:
        return np.inf
    turned = [other.points, other.points[::-1]] if one.dim == 2 else [other.points]
    return min(float(np.linalg.norm(one.points - points, axis=1).max()) for points in turned)


def _require_same_measure(both: str, first: Study, other: Study) -> None:
    seen = [study.observations(observations_of(study)) for study in (first, other)]
    studies = zip((first, other), seen, strict=True)
    one, two = (in_words(adapted(study.measure, some[0]) if some else study.measure) for study, some in studies)
    if one != two:
        _refuse(f"{both}: the measures differ", f"{one} and {two}", "the same measure first under discrepancy")


def _require_same_noise(both: str, first: Study, other: Study) -> None:
    for name in observations_of(first):
        one, two = (_stated(study.noise_of(name)) for study in (first, other))
        shares = two.get("shares")
        turned = {**two, "shares": shares[::-1]} if isinstance(shares, tuple) else two
        if one in (two, turned):
            continue
        of = f" of {_condition(name)}" if name else ""
        different = [key for key in one if one[key] != two.get(key)] or ["its kind"]
        value = "; ".join(f"{key} {one.get(key)} and {two.get(key)}" for key in different if key != "shares")
        expected = "the same errors of the data in both; model_error and spread may differ"
        _refuse(f"{both}: the noise{of} differs", value or "other errors of single points", expected)


def _stated(noise: Noise | PointErrors | UnknownErrors) -> dict[str, object]:
    """Return what is stated about the errors of the data, without those of the model."""
    if isinstance(noise, PointErrors | UnknownErrors):
        return {"kind": "points", **{key: getattr(noise, key, DEFAULTS.get(key)) for key in OF_POINTS}}
    return {"kind": type(noise).__qualname__, **noise.facts}


def _require_known_range(name: str, study: Study) -> None:
    """Refuse unknown errors without a range: each model would then get another prior, from its own residuals."""
    for condition in observations_of(study):
        noise = study.noise_of(condition)
        if isinstance(noise, UnknownErrors) and (noise.sd is None or noise.length is None):
            _refuse(
                f"{name} cannot be compared: the range of its unknown noise is not stated",
                "sd or length: unknown",
                "a value or a range, since the evidence depends on it",
                "State a range, e.g. noise: {sd: [1, 10], length: [5, 50], unit: um}, in all studies.",
            )


def _require_same_supports(both: str, first: Study, other: Study) -> None:
    for parameter in first.space:
        if parameter.name not in other.space.names:
            continue
        second = other.space[parameter.name]
        if parameter.unit != second.unit:
            value = f"{parameter.unit} and {second.unit}"
            _refuse(f"{both}: the units of {parameter.name} differ", value, "the same unit of a shared input")
        if not np.allclose(parameter.interval, second.interval, rtol=1e-12, atol=0.0):
            value = " and ".join(f"[{low:g}, {high:g}]" for low, high in (parameter.interval, second.interval))
            _refuse(
                f"{both}: the supports of the priors of {parameter.name} differ",
                value,
                "the same support of a shared input",
                "Give it the same box or prior in both, or another name if it means something else.",
            )


def _condition(name: str) -> str:
    return name or "a condition without a name"


def _refuse(what: str, value: str, expected: str, remedy: str = "Make them the same and run again.") -> None:
    raise InvalidStudy(what, value=value, expected=expected, remedy=remedy)
