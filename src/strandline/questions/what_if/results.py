"""what-if.json: the present posterior, its alternatives, and what moves."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from strandline.calibration.alternative import Present
from strandline.calibration.what_if import LEAST_RATIO, LEAST_SHIFT, Answer
from strandline.posterior.weighted import Weighted
from strandline.studies.provenance import versions
from strandline.studies.study import Study
from strandline.text import listed
from strandline.version import __version__

__all__ = ["describe_what_if", "in_order"]

TO_MICROMETRES = 1e3
LEVELS = (0.05, 0.95)
"""Probabilities below the ends of the 90 % intervals."""
CUT = 1e-3
"""Prior probability outside the box from which it is reported."""
PRIOR = "the prior of "
LARGE = 0.05
"""Distance between the stored posterior and that of the surrogate of the interface, in sd, from which it is said."""


def in_order(answers: Sequence[Answer]) -> tuple[Answer, ...]:
    """Return the answers that move, the largest first, then the questions without an answer, then the others."""
    return tuple(sorted(answers, key=lambda one: (0 if one.moves else 1 if one.by is None else 2, -one.size)))


def describe_what_if(study: Study, now: Present, answers: Sequence[Answer], *, seed: int) -> dict[str, Any]:
    """Return the content of what-if.json.

    Args:
        study: The study.
        now: The present posterior.
        answers: The posterior under each alternative, in their order.
        seed: Seed of all random numbers.
    """
    return {
        "study": study.name,
        "study_sha256": study.text_digest,
        "version": __version__,
        "versions": versions(),
        "model": study.runs.identity,
        "seed": seed,
        "conclusion": _conclusion(answers),
        "remarks": _remarks(study, now, answers),
        "limits": {"shift": LEAST_SHIFT, "sd_ratio": LEAST_RATIO},
        "surrogate": _surrogate(now),
        "present": {
            "log_evidence": now.log_evidence,
            "effective": float(1 / np.sum(now.weighted.weights**2)),
            "inputs": {
                one.name: {"label": one.shown, "unit": one.unit, **_moments(now.weighted, i)}
                for i, one in enumerate(now.space)
            },
        },
        "alternatives": [_alternative(one) for one in answers],
    }


def _conclusion(answers: Sequence[Answer]) -> str:
    """Return what the posterior depends on, in a sentence."""
    if all(one.by is None for one in answers):
        return "None of the alternatives can be computed without new runs."
    subjects = list(dict.fromkeys(one.alternative.about for one in answers if one.moves))
    if not subjects:
        return (
            f"The posterior depends on nothing that was tried: no mean moves by more than {LEAST_SHIFT:g} sd, and no "
            f"sd changes by more than a factor of {LEAST_RATIO:g}."
        )
    words = listed(_with_priors_together(subjects))
    comma = "," if " and " in words else ""
    return f"The posterior depends on {words}{comma} and on nothing else that was tried."


def _with_priors_together(subjects: Sequence[str]) -> list[str]:
    """Return the subjects, with those that are priors as one, in the place of the first."""
    names = [one.removeprefix(PRIOR) for one in subjects if one.startswith(PRIOR) and " and " not in one]
    if len(names) < 2:
        return list(subjects)
    together = f"the priors of {listed(names)}"
    return list(dict.fromkeys(together if one.removeprefix(PRIOR) in names else one for one in subjects))


def _remarks(study: Study, now: Present, answers: Sequence[Answer]) -> list[str]:
    out = []
    number = sum(one.by is None for one in answers)
    if number:
        out.append(
            f"{number} of {len(answers)} alternatives cannot be computed without new runs. Copy the study, make the "
            f"change in its study.yaml with `reuse: [../{study.folder.resolve().name}]`, and run it."
        )
    if now.knowledge is None:
        out.append(f"Only other priors were tried: {now.why_not}.")
    elif now.shift > LARGE:
        out.append(
            f"Through the surrogate of the interface, the posterior is {now.shift:.2g} sd away from that of the study, "
            "which learns the log-likelihood. Both sides of each comparison use the surrogate."
        )
    if now.space.nuisance:
        out.append("The posterior is the joint one, in which the data inform the nuisance inputs too.")
    return out


def _surrogate(now: Present) -> dict[str, Any] | None:
    """Return how good the surrogate of the interface is at the present posterior; None if it was not used."""
    quality = now.quality
    if now.knowledge is None or quality is None:
        return None
    return {
        "runs": now.knowledge.surrogate.runs,
        "hidden_um": TO_MICROMETRES * quality.hidden,
        "error_um": {"median": TO_MICROMETRES * quality.median, "q95": TO_MICROMETRES * quality.q95},
        "beyond": quality.beyond,
        "shift": now.shift,
    }


def _alternative(one: Answer) -> dict[str, Any]:
    asked = one.alternative
    cut = {parameter.name: parameter.mass_cut for parameter in asked.space if parameter.mass_cut > CUT}
    return {
        "name": asked.name,
        "kind": asked.kind,
        "about": asked.about,
        "detail": asked.detail,
        "mass_cut": cut,
        "by": one.by,
        "k_hat": one.k_hat if math.isfinite(one.k_hat) else None,
        "effective": one.effective,
        "log_evidence_change": one.log_evidence_change,
        "beyond": None if one.quality is None else one.quality.beyond,
        "moves": one.moves,
        "why_not": one.why_not,
        "inputs": {} if one.draws is None else _inputs(one, one.draws),
    }


def _inputs(one: Answer, draws: Weighted) -> dict[str, Any]:
    return {
        name: {
            **_moments(draws, i),
            "shift": float(one.shift[i]),
            "shift_error": float(one.shift_error[i]),
            "sd_ratio": float(one.sd_ratio[i]),
            "moves": name in one.moved,
        }
        for i, name in enumerate(one.present.space.names)
        if name not in one.alternative.fixed
    }


def _moments(draws: Weighted, i: int) -> dict[str, float]:
    """Return mean, standard deviation and 90 % interval of an input."""
    low, high = np.quantile(draws.draws[:, i], LEVELS, weights=draws.weights, method="inverted_cdf")
    return {"mean": float(draws.mean[i]), "sd": float(draws.sd[i]), "low": float(low), "high": float(high)}
