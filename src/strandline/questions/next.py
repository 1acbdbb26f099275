"""Which experiment to make next: candidates of a study ranked by what they can be expected to teach.

Before any data, this follows from a few runs at draws of the prior: the interface is taken to be linear in the inputs
near each draw, and the prior to be normal.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline import studies
from strandline.calibration import Errors, Footprint, Observer, errors_behind, footprint, observer_or_default
from strandline.design import Candidate, Look, key_of, sobol
from strandline.foundations import InvalidStudy, TooFewRuns, one_thread, require, unit_text, use_double
from strandline.interface import Interface, UnknownErrors
from strandline.models import undeformed_interface
from strandline.posterior import Weighted
from strandline.questions.answer import TO_MICROMETRES, Answer, Part, Symbol, Table, digits
from strandline.questions.information import (
    Answers,
    CandidateAnswer,
    directions_left,
    in_words,
    linear_outlook,
    ranked,
    scale_of,
    shown_columns,
)
from strandline.questions.knowledge import PointRuns, problem_of, require_seed, runs_at
from strandline.questions.observing import Observing, View
from strandline.questions.prospects import answers_from_posterior
from strandline.report import Captioned, plots, without_coefficients
from strandline.runs import Executor, RunRecord

__all__ = ["next_experiment"]
SOURCES = ("prior", "posterior")
FEWEST_RUNS, FEWEST_DRAWS, MOST_DRAWS = 4, 200, 4000


def next_experiment(
    study: studies.Study,
    *,
    source: str | None = None,
    draws: int = 1000,
    runs: int = 8,
    seed: int = 1,
    executor: Executor | None = None,
    observer: Observer | None = None,
) -> Answer[Answers]:
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
    studies.require_study(study)
    _require_arguments(source, draws, runs, seed)
    begun, tell = time.perf_counter(), observer_or_default(observer)
    executor = executor or study.executor
    found = study.results == "current" and (study.folder / studies.POSTERIOR).is_file()
    after = source == "posterior" or (source is None and found)
    if source == "posterior":
        studies.finished_posterior(study, purpose="plan from")
    candidates = _candidates(study, after=after)
    studies.require_writable(study.folder)
    use_double()
    with one_thread():
        if after:
            made = answers_from_posterior(study, candidates, draws=draws, seed=seed, executor=executor, observer=tell)
        else:
            made = answers_from_prior(study, candidates, runs=runs, executor=executor, observer=tell)
    tell.stage("report")
    content = _described(study, made, seed=seed, seconds=time.perf_counter() - begun)
    return _answer(without_coefficients(content, study.space), made, study.folder).written(draft=study.settings.draft)


def _candidates(study: studies.Study, *, after: bool) -> tuple[Candidate, ...]:
    """Return the candidates; before any data there may be none, since the planned experiment is one."""
    if study.candidates or not after:
        return study.candidates
    known = next(iter(study.fixed), None)
    what = "study.yaml lists no candidates for the next experiment"
    expected = "e.g. `next: {part: [[0, 0.5], [0.5, 1]]}`"
    if known:
        expected = f"e.g. `next: {{{known}: [{study.fixed[known]:g}, {2 * study.fixed[known]:g}]}}`"
    remedy = "Add them; the results of the study stay as they are."
    raise InvalidStudy(what, value=None, expected=expected, remedy=remedy)


def _require_arguments(source: str | None, draws: int, runs: int, seed: int) -> None:
    require(source in (None, *SOURCES), "source of the next experiment", source, " or ".join(SOURCES))
    several = f"from {FEWEST_DRAWS} to {MOST_DRAWS}", "1000 are a good start; more make the gains more certain."
    require(FEWEST_DRAWS <= draws <= MOST_DRAWS, "draws of the posterior", draws, *several)
    require(runs >= FEWEST_RUNS, "runs of each candidate", runs, f"at least {FEWEST_RUNS}", "8 are a good start.")
    require_seed(seed, "the next experiment")


AGAIN = {"prior": "as planned", "posterior": "the same again"}  # words for an experiment with the study's own settings
NOTHING = 0.1  # gain, nats, below which the advice says that an experiment teaches little
AS_GOOD = 0.05  # difference, nats, within which the advice calls two candidates equally good
RISKY = 0.2  # probability of failure from which the advice mentions it
UNKNOWN, PARTLY = 0.85, 0.5  # shares of the prior's sd above which a direction is not determined, or only roughly


def _described(study: studies.Study, found: Answers, *, seed: int, seconds: float) -> dict[str, Any]:
    answers, sd = ranked(found.answers), found.now.sd
    together = groupby(answers, key=lambda one: len(one.candidate.settings))
    return {
        **studies.facts_of(study, seed),
        "source": found.source,
        "draws": len(found.now.draws),
        "inputs": {
            one.name: {
                "label": one.shown,
                "unit": one.unit,
                "mean": float(found.now.mean[k]),
                "sd": float(sd[k]),
                "calibrated": not one.nuisance,
            }
            for k, one in enumerate(study.space)
        },
        "noise": [_noise(study, found, name) for name in found.errors],
        "advice": " ".join(_best(study, found, list(some), number) for number, some in together),
        "candidates": [_candidate(study, one, AGAIN[found.source], sd) for one in answers],
        "directions": [
            {
                "weights": dict(zip(study.space.names, one.weights.tolist(), strict=True)),
                "left": one.left,
                "in_words": in_words(one, study.space.names),
            }
            for one in found.directions
        ],
        "identifiability": _identifiability(study, found),
        "runs": {"new": found.new, "reused": found.reused},
        "seconds": seconds,
    }


def _noise(study: studies.Study, found: Answers, condition: str) -> dict[str, Any]:
    """Return the errors of the points of a condition; before any data, unknown ones are a guess."""
    guessed = found.source == "prior" and isinstance(study.noise_of(condition), UnknownErrors)
    sd = TO_MICROMETRES * found.errors[condition].sd
    words = f"standard deviation of each point {sd:.3g} µm"
    if guessed:
        words += ", a guess: the study does not know its noise"
    return {"condition": condition, "sd_um": sd, "guessed": guessed, "in_words": words}


def _candidate(study: studies.Study, one: CandidateAnswer, again: str, sd: np.ndarray) -> dict[str, Any]:
    names, outlook, look = study.space.names, one.outlook, one.candidate.look
    gained: dict[str, Any] = {"gain": None, "error": None, "by": None, "sd": None, "sd_ratio": None}
    if outlook is not None:
        gained = {
            **studies.named(outlook, "gain", "error", "by"),
            "sd": dict(zip(names, outlook.sd.tolist(), strict=True)),
            "sd_ratio": dict(zip(names, (outlook.sd / sd).tolist(), strict=True)),
        }
    return {
        "label": one.candidate.label(again),
        "settings": [dict(setting) for setting in one.candidate.settings],
        "conditions": list(look.conditions),
        "part": list(look.part),
        "points": look.points,
        "sd_of_points_mm": look.sd,
        **gained,
        "worth": None if outlook is None else one.worth,
        "failing": one.failing,
        "displacement_in_sd": one.displacement,
        "problem": one.problem,
    }


def _identifiability(study: studies.Study, found: Answers) -> list[str]:
    picture, leaves, determines, cannot = (
        ("The picture", "leaves", "determines", "cannot determine")
        if found.source == "posterior"
        else ("The planned picture", "would leave", "would determine", "could not determine")
    )
    lines = []
    for one in found.directions:
        what, left = in_words(one, study.space.names), f"it {leaves} {100 * one.left:.0f} % of the prior's width"
        if one.left > UNKNOWN:
            lines.append(f"{picture} {cannot} {what}: {left}.")
        elif one.left > PARTLY:
            lines.append(f"{picture} {determines} {what} only roughly: {left}.")
        elif not lines:  # the first one is known least
            return [f"{picture} {determines} all combinations of the inputs, {what} least well: {left}."]
    return lines


def _best(study: studies.Study, found: Answers, answers: Sequence[CandidateAnswer], number: int) -> str:
    again, best = AGAIN[found.source], answers[0]
    of = f"Of {number} experiments together: " if number > 1 else ""
    if best.outlook is None:
        return f"{of}Every candidate's run failed."
    label = _words(best.candidate, again)
    if best.outlook.gain < NOTHING:
        return f"{of}None of the candidates teaches much; the best is {label} with {best.outlook.gain:.2f} nats."
    now, names = found.now.sd, study.space.names
    shown = set(study.space.calibrated) & set(shown_columns(study.space))
    ratios = {names[k]: best.outlook.sd[k] / now[k] for k in sorted(shown)}
    fall = ""
    if ratios:
        least = min(ratios, key=lambda name: ratios[name])
        fall = f"; the standard deviation of {least} is expected to fall by {100 * (1 - ratios[least]):.0f} %"
    words = f"Choose {label}" if number == 1 and len(answers) > 1 else label
    text = f"{of}{words[0].upper() if not of else words[0]}{words[1:]}: {best.outlook.gain:.2f} nats{fall}."
    if best.failing is not None and best.failing > RISKY:
        text += f" It fails with a probability of {100 * best.failing:.0f} %, though."
    close = [_words(one.candidate, again) for one in answers[1:] if one.worth > best.worth - AS_GOOD]
    if close:
        text += f" Equally good, within {AS_GOOD} nats: {'; '.join(close[:3])}{', …' if len(close) > 3 else ''}."
    return text


def _words(candidate: Candidate, again: str) -> str:
    return candidate.label(again if again != "as planned" else "the planned experiment")


def _answer(content: dict[str, Any], found: Answers, folder: Path) -> Answer[Answers]:
    after, runs = content["source"] == "posterior", content["runs"]
    determines = "the picture determines" if after else "the planned picture would determine"
    noise = [f"{one['condition'] or 'Noise'}: {one['in_words']}." for one in content["noise"]]
    made = f"{runs['new']} new forward runs, {runs['reused']} known; {digits(content['seconds'], 3)} s"
    return Answer(
        title=f"{content['study']}: the next experiment",
        lead="What further experiments would teach, given the posterior."
        if after
        else "What experiments would teach, before any data (linearised).",
        sentence=content["advice"],
        remarks=(),
        good=True,
        parts=[
            _of_candidates(content),
            Part(f"What {determines}", lines=content["identifiability"]),
            Part("How it was computed", lines=[*noise, made], notes="how_planned"),
        ],
        content=content,
        found=found,
        page=folder / "next.html",
        drawn=_drawn,
    )


MOST_CANDIDATES = 20  # candidates that are drawn


def _drawn(content: Mapping[str, Any]) -> Iterator[Captioned]:
    drawn = [one for one in content["candidates"] if one["gain"] is not None][:MOST_CANDIDATES]
    names = {name: item["label"] for name, item in content["inputs"].items()}
    if drawn:
        yield Captioned.of("next_candidates", "next", plots.plot_candidates(drawn, names))
    if len(names) > 1:
        yield Captioned.of("next_directions", "next", plots.plot_directions(content["directions"], names))


def _of_candidates(content: Mapping[str, Any]) -> Part:
    inputs = content["inputs"]
    units = [unit_text(item["unit"]) for item in inputs.values()]
    within = [f" [{unit}]" if unit else "" for unit in units]
    sds = [Symbol(f"sd{unit} of {item['label']}") for item, unit in zip(inputs.values(), within, strict=True)]
    head = ("candidate", "gain, nats", *sds, "fails", "moved, sd", "by")
    now = ("(now)", "", *(digits(item["sd"], 3) for item in inputs.values()), "", "", "")
    rows = [now, *(_row(one, list(inputs)) for one in content["candidates"])]
    known = [k for k in range(len(head)) if any(row[k] not in ("", "–") for row in rows if len(row) == len(head))]
    kept = [[row[k] for k in known] if len(row) == len(head) else row for row in (head, *rows)]
    return Part("The candidates", Table(kept[0], kept[1:]), notes="candidates")


def _row(one: Mapping[str, Any], names: Sequence[str]) -> tuple[str, ...]:
    if one["gain"] is None:
        return one["label"], one["problem"]
    error = f" ± {one['error']:.2f}" if one["error"] else ""
    return (
        one["label"],
        f"{one['gain']:.2f}{error}",
        *(digits(one["sd"][name], 3) for name in names),
        "–" if one["failing"] is None else f"{one['failing']:.0%}",
        "–" if one["displacement_in_sd"] is None else digits(one["displacement_in_sd"], 3),
        one["by"],
    )


SCRAMBLE = 0
PRIOR_STEP = 0.05  # step of runs beside a draw, in standard deviations of the prior
PRIOR_DRAWS = 4096
PLANNED = Candidate(({},), Look())  # the experiment of the study
_Experiment = tuple[Observing, Float[np.ndarray, "dim dim"]]


def answers_from_prior(
    study: studies.Study, candidates: Sequence[Candidate], *, runs: int, executor: Executor, observer: Observer
) -> Answers:
    """Return what the planned experiment and each candidate can be expected to teach before any data.

    Each is run at so many draws of the prior.
    """
    space = study.space
    x = space.prior_quantiles(sobol(runs, space.dim, scramble=SCRAMBLE))
    asked = [PLANNED, *(one for one in candidates if one != PLANNED)]
    settings = list({key_of(one): one for candidate in asked for one in candidate.settings}.values())
    observer.stage("candidates")
    made = runs_at(
        study,
        [(setting, row) for setting in settings for row in x],
        PRIOR_STEP * space.prior_sd,
        usable=lambda record: studies.slopes_by_sensitivities(record, space.names) is not None,
        executor=executor,
        observer=observer,
    )
    observer.stage("gains")
    at = {key_of(setting): made.points[k * runs : (k + 1) * runs] for k, setting in enumerate(settings)}
    failed = [problem_of(one.failed) for one in at[key_of({})] if one.failed is not None]
    good = [one for one in at[key_of({})] if one.failed is None]
    what, words = "the planned experiment failed at every draw of the prior", "a prior where the simulator runs"
    remedy = f"Look at the failures, or move the priors to where it runs. The first: {''.join(failed[:1])}"
    require(good, what, f"0 of {runs}", words, remedy, TooFewRuns)
    errors = _errors(study, good[0].run, asked)
    now = Weighted(
        space.prior_quantiles(sobol(PRIOR_DRAWS, space.dim, scramble=SCRAMBLE)), np.full(PRIOR_DRAWS, 1 / PRIOR_DRAWS)
    )
    planned = [information for _, information in _experiments(study, errors, good, PLANNED.look)]
    value = "runs whose interfaces have different nodes, and no sensitivities"
    expected = "interfaces with the same nodes in all runs, or sensitivities"
    remedy = "Let the simulator return the same nodes, or finish the study and plan from its posterior."
    require(planned, "slopes of the interface in the inputs", value, expected, remedy)
    return Answers(
        source="prior",
        now=now,
        errors=errors,
        answers=tuple(_before(study, errors, candidate, at, now) for candidate in asked),
        directions=directions_left(scale_of(space), np.array([one.x for one in good]), planned, shown_columns(space)),
        new=made.new,
        reused=made.reused,
    )


def _experiments(
    study: studies.Study, errors: Mapping[str, Errors], points: Sequence[PointRuns], look: Look
) -> Iterator[_Experiment]:
    """Yield how the experiment is observed at each point whose runs succeeded, and its Fisher information."""
    for one in points:
        if one.failed is not None:
            continue
        slopes = studies.slopes_by_sensitivities(one.run, study.space.names)
        slopes = slopes or studies.slopes_by_differences(one.run, one.others, one.x, one.beside)
        if slopes is not None:
            names = look.conditions or study.observed or one.run.interfaces
            views = {name: View(_places(study, one.run, name), errors[name]) for name in names}
            observing = Observing(views, {name: one.run.interfaces[name].points for name in names}).focused(look)
            yield observing, observing.fisher(slopes)


def _errors(study: studies.Study, run: RunRecord, asked: Sequence[Candidate]) -> dict[str, Errors]:
    """Return the errors of the points in each condition that is, or would be, observed, near a run that succeeded."""
    measure, found = study.measure, {}
    wanted = {*(study.observed or run.interfaces), *(name for one in asked for name in one.look.conditions)}
    for name in sorted(wanted):
        places, nodes = _places(study, run, name), run.interfaces[name].points
        seen = study.observation(Interface(places.on(nodes), places.cells), name)
        found[name] = errors_behind(seen, measure, len(nodes))
    return found


def _places(study: studies.Study, run: RunRecord, name: str) -> Footprint:
    simulated = run.interfaces[name]
    return footprint(study.observed.get(name, simulated), simulated)


def _before(
    study: studies.Study,
    errors: Mapping[str, Errors],
    candidate: Candidate,
    at: Mapping[str, Sequence[PointRuns]],
    now: Weighted,
) -> CandidateAnswer:
    """Return what one candidate can be expected to teach; experiments made together share the draws of the inputs."""
    several = [at[key_of(setting)] for setting in candidate.settings]
    good = [k for k, points in enumerate(zip(*several, strict=True)) if all(one.failed is None for one in points)]
    failing = 1 - len(good) / len(several[0])
    if not good:
        failed = next(one.failed for points in several for one in points if one.failed is not None)
        return CandidateAnswer(candidate, None, failing, None, problem_of(failed))
    found = [[*_experiments(study, errors, [points[k] for k in good], candidate.look)] for points in several]
    if not all(len(one) == len(good) for one in found):
        why = "the runs have different nodes, so that they give no slopes"
        return CandidateAnswer(candidate, None, failing, None, why)
    informations = [np.sum([one[k][1] for one in found], axis=0) for k in range(len(good))]
    rest = undeformed_interface(study.model)
    sizes = [
        seen.displacement(dict.fromkeys(seen.reference, rest.points))
        for several in found
        for seen, _ in several
        if rest is not None and all(nodes.shape == rest.points.shape for nodes in seen.reference.values())
    ]
    outlook = linear_outlook(now.covariance, informations, interest=study.space.calibrated)
    return CandidateAnswer(candidate, outlook, failing, float(np.median(sizes)) if sizes else None)
