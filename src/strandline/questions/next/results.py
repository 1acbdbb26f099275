"""next.json: what each candidate for the next experiment can be expected to teach, as plain numbers."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from strandline.interface import UnknownErrors
from strandline.planning.candidate import Candidate
from strandline.planning.identifiability import Direction, in_words
from strandline.questions.next.answers import Answer, Answers, ranked
from strandline.studies.provenance import versions
from strandline.studies.study import Study
from strandline.version import __version__

__all__ = ["describe_next"]

AGAIN = {"prior": "as planned", "posterior": "the same again"}
"""Words for an experiment with the study's own settings."""
TO_MICROMETRES = 1e3
NOTHING = 0.1
"""Gain, nats, below which the advice says that an experiment teaches little."""
AS_GOOD = 0.05
"""Difference, nats, within which the advice calls two candidates equally good."""
RISKY = 0.2
"""Probability of failure from which the advice mentions it."""
UNKNOWN, PARTLY = 0.85, 0.5
"""Shares of the prior's standard deviation above which a direction is not determined, or only roughly."""


def describe_next(study: Study, found: Answers, *, seed: int, seconds: float) -> dict[str, Any]:
    """Return the content of next.json; candidates come in the order of their worth, single experiments first.

    Args:
        study: The study.
        found: What the candidates can be expected to teach.
        seed: Seed of all random numbers.
        seconds: Wall time of the command.
    """
    answers = ranked(found.answers)
    sd = found.now.sd
    return {
        "study": study.name,
        "study_sha256": study.text_digest,
        "version": __version__,
        "versions": versions(),
        "model": study.runs.identity,
        "source": found.source,
        "seed": seed,
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
        "advice": _advice(study, found, answers),
        "candidates": [_described(study, one, AGAIN[found.source], sd) for one in answers],
        "directions": [_direction(study, one) for one in found.directions],
        "identifiability": _identifiability(study, found),
        "runs": {"new": found.new, "reused": found.reused},
        "seconds": seconds,
    }


def _noise(study: Study, found: Answers, condition: str) -> dict[str, Any]:
    """Return the errors of the points of a condition; before any data, unknown ones are a guess."""
    guessed = found.source == "prior" and isinstance(study.noise_of(condition), UnknownErrors)
    sd = TO_MICROMETRES * found.errors[condition].sd
    words = f"standard deviation of each point {sd:.3g} µm"
    if guessed:
        words += ", a guess: the study does not know its noise"
    return {"condition": condition, "sd_um": sd, "guessed": guessed, "in_words": words}


def _described(study: Study, one: Answer, again: str, sd: np.ndarray) -> dict[str, Any]:
    names, outlook, look = study.space.names, one.outlook, one.candidate.look
    gained: dict[str, Any] = {"gain": None, "error": None, "by": None, "sd": None, "sd_ratio": None}
    if outlook is not None:
        gained = {
            "gain": outlook.gain,
            "error": outlook.error,
            "by": outlook.by,
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


def _direction(study: Study, one: Direction) -> dict[str, Any]:
    weights = dict(zip(study.space.names, one.weights.tolist(), strict=True))
    return {"weights": weights, "left": one.left, "in_words": in_words(one, study.space.names)}


def _identifiability(study: Study, found: Answers) -> list[str]:
    """Return which combinations of the inputs the picture cannot determine, in words."""
    after = found.source == "posterior"
    picture, leaves, determines, cannot = (
        ("The picture", "leaves", "determines", "cannot determine")
        if after
        else ("The planned picture", "would leave", "would determine", "could not determine")
    )
    lines = []
    for one in found.directions:
        what, left = in_words(one, study.space.names), f"it {leaves} {100 * one.left:.0f} % of the prior's width"
        if one.left > UNKNOWN:
            lines.append(f"{picture} {cannot} {what}: {left}.")
        elif one.left > PARTLY:
            lines.append(f"{picture} {determines} {what} only roughly: {left}.")
    if not lines:
        worst = found.directions[0]
        what, left = in_words(worst, study.space.names), f"it {leaves} {100 * worst.left:.0f} % of the prior's width"
        lines.append(f"{picture} {determines} all combinations of the inputs, {what} least well: {left}.")
    return lines


def _advice(study: Study, found: Answers, answers: Sequence[Answer]) -> str:
    """Return what to do next in a few sentences: the best experiment, and the best of several together."""
    numbers = sorted({len(one.candidate.settings) for one in answers})
    return " ".join(
        _best(study, found, [one for one in answers if len(one.candidate.settings) == number], number)
        for number in numbers
    )


def _best(study: Study, found: Answers, answers: Sequence[Answer], number: int) -> str:
    """Return the best of candidates with the same number of experiments, in words."""
    again, best = AGAIN[found.source], answers[0]
    of = f"Of {number} experiments together: " if number > 1 else ""
    if best.outlook is None:
        return f"{of}Every candidate's run failed."
    label = _words(best.candidate, again)
    if best.outlook.gain < NOTHING:
        return f"{of}None of the candidates teaches much; the best is {label} with {best.outlook.gain:.2f} nats."
    now, names = found.now.sd, study.space.names
    ratios = {names[k]: best.outlook.sd[k] / now[k] for k in study.space.calibrated}
    least = min(ratios, key=lambda name: ratios[name])
    fall = f"the standard deviation of {least} is expected to fall by {100 * (1 - ratios[least]):.0f} %."
    words = f"Choose {label}" if number == 1 and len(answers) > 1 else label
    text = f"{of}{words[0].upper() if not of else words[0]}{words[1:]}: {best.outlook.gain:.2f} nats; {fall}"
    if best.failing is not None and best.failing > RISKY:
        text += f" It fails with a probability of {100 * best.failing:.0f} %, though."
    close = [_words(one.candidate, again) for one in answers[1:] if one.worth > best.worth - AS_GOOD]
    if close:
        text += f" Equally good, within {AS_GOOD} nats: {'; '.join(close[:3])}{', …' if len(close) > 3 else ''}."
    return text


def _words(candidate: Candidate, again: str) -> str:
    return candidate.label(again if again != "as planned" else "the planned experiment")
