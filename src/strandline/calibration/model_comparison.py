"""Which of several models explains the same data best: Bayes factors in words, and the average over the models.

The words are those of Kass and Raftery (1995), who scale 2 ln B; here it is ln B, in nats. Below 1 nat, or below two
errors of ln B, no model is preferred.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from strandline.calibration.evidence import Evidence
from strandline.errors import InvalidInput
from strandline.posterior.weighted import Weighted
from strandline.text import listed

__all__ = ["CANNOT_TELL", "ERRORS", "SCALE", "BayesFactor", "ModelComparison", "averaged", "in_words", "require_odds"]

SCALE = ((1.0, "positive"), (3.0, "strong"), (5.0, "very strong"))
"""Least |ln B| of each word."""
ERRORS = 2.0
"""Smallest |ln B| of a decision, in standard errors of ln B."""
CANNOT_TELL = "cannot tell"


def in_words(ln: float, error: float) -> str:
    """Return how strong the evidence of a Bayes factor is, or ``cannot tell``.

    Args:
        ln: ln B, in nats.
        error: Standard error of it.
    """
    size = abs(ln)
    if not (size >= SCALE[0][0] and size >= ERRORS * error):  # also if one of them is not a number
        return CANNOT_TELL
    return next(word for least, word in reversed(SCALE) if size >= least)


@dataclass(frozen=True)
class BayesFactor:
    """The ratio of the evidences of two models.

    Args:
        of: Name of the model with the larger evidence.
        over: Name of the other one.
        ln: Natural logarithm of the ratio, at least 0.
        error: Standard error of it.
    """

    of: str
    over: str
    ln: float
    error: float

    def __repr__(self) -> str:
        return f"<BayesFactor of {self.of} over {self.over}: ln B = {self.ln:.3g} ± {self.error:.2g}, {self.words}>"

    @property
    def words(self) -> str:
        """Strength of the evidence on the scale, or ``cannot tell``."""
        return in_words(self.ln, self.error)

    @property
    def decided(self) -> bool:
        """Whether the first model is preferred."""
        return self.words != CANNOT_TELL


@dataclass(frozen=True)
class ModelComparison:
    """Evidences of models of the same data.

    Args:
        evidences: Evidence of each model by name.
        odds: Prior probabilities of the models relative to each other, by name, above 0; equal if omitted.

    Raises:
        InvalidInput: Fewer than two models, or odds that are not finite numbers above 0, one for each model.
    """

    evidences: Mapping[str, Evidence]
    odds: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        if len(self.evidences) < 2:
            raise InvalidInput(
                "models to compare",
                value=len(self.evidences),
                expected="at least 2",
                remedy="Give another one.",
            )
        if self.odds is not None:
            require_odds([self.odds.get(name, math.nan) for name in self.evidences], len(self.evidences))

    def __repr__(self) -> str:
        return f"<ModelComparison: {self.verdict}>"

    @cached_property
    def order(self) -> tuple[str, ...]:
        """Names of the models, that with the largest evidence first."""
        return tuple(sorted(self.evidences, key=lambda name: -self.evidences[name].log))

    @cached_property
    def factors(self) -> tuple[BayesFactor, ...]:
        """The Bayes factor of each pair of models, those of the best one first."""
        return tuple(self._factor(one, other) for one, other in combinations(self.order, 2))

    @property
    def prior(self) -> dict[str, float]:
        """Prior probabilities of the models."""
        odds = self.odds or dict.fromkeys(self.evidences, 1.0)
        whole = sum(odds[name] for name in self.evidences)
        return {name: odds[name] / whole for name in self.evidences}

    @cached_property
    def probabilities(self) -> dict[str, float]:
        """Posterior probabilities of the models, if one of them is right."""
        logs = np.array([self.evidences[name].log + math.log(share) for name, share in self.prior.items()])
        weights = np.exp(logs - logs.max())
        return dict(zip(self.prior, (weights / weights.sum()).tolist(), strict=True))

    @property
    def favoured(self) -> str | None:
        """The model that is preferred to every other one; None if there is none."""
        best = self.order[0]
        return best if all(one.decided for one in self._of_best) else None

    @property
    def tied(self) -> tuple[str, ...]:
        """The models between which the data cannot tell: the best one and those that it is not preferred to."""
        return (self.order[0], *(one.over for one in self._of_best if not one.decided))

    @property
    def verdict(self) -> str:
        """The verdict in a sentence."""
        if self.favoured is not None:
            second = self._of_best[0]
            return f"The data favour {second.of} over {second.over}: ln B = {_shown(second)}, {second.words} evidence."
        nearest = next(one for one in self._of_best if not one.decided)
        found = f"ln B = {_shown(nearest)} of {nearest.of} over {nearest.over}"
        if nearest.ln < SCALE[0][0]:
            return f"The data cannot tell {listed(self.tied)} apart: {found}, below 1."
        return (
            f"The data cannot tell {listed(self.tied)} apart: {found}, less than {ERRORS:g} errors. "
            "More runs, or more particles, make the error smaller."
        )

    @property
    def _of_best(self) -> tuple[BayesFactor, ...]:
        return self.factors[: len(self.order) - 1]

    def _factor(self, one: str, other: str) -> BayesFactor:
        first, second = self.evidences[one], self.evidences[other]
        return BayesFactor(one, other, first.log - second.log, math.hypot(first.error, second.error))


def require_odds(odds: Sequence[float], number: int) -> None:
    """Refuse prior odds that are not numbers above 0, one for each model.

    Raises:
        InvalidInput: They are not.
    """
    if len(odds) != number or not all(math.isfinite(one) and one > 0 for one in odds):
        raise InvalidInput(
            "prior odds of the models",
            value=":".join(f"{one:g}" for one in odds),
            expected=f"{number} numbers above 0, one for each model",
            remedy="Give them in the order of the models, e.g. 2:1.",
        )


def averaged(posteriors: Sequence[Weighted], probabilities: Sequence[float]) -> Weighted:
    """Return the mixture of the posteriors of several models, each with the probability of its model.

    Args:
        posteriors: Draws of the same inputs under each model.
        probabilities: Probabilities of the models, whose sum is 1.
    """
    draws = np.concatenate([one.draws for one in posteriors])
    weights = [share * one.weights for one, share in zip(posteriors, probabilities, strict=True)]
    return Weighted(draws, np.concatenate(weights))


def _shown(one: BayesFactor) -> str:
    return f"{one.ln:.2f} ± {one.error:.2f}"
