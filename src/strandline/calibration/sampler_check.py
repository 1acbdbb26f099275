"""Do two independent halves of the sampler's particles agree? The check of the sampler above three inputs.

Tempered Sequential Monte Carlo fails where few particles find the way to most of the mass: a funnel that narrows, or a
narrow mode beside a wide one. Its weights do not show this, since every particle descends from the few. Independent
runs do: they differ by more than the effective sizes of their weights explain. What both miss, they cannot show.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import kolmogorov, logsumexp, ndtr

from strandline.posterior import Posterior, Weighted
from strandline.smc import SMCResult

LEVEL = 0.01  # probability, corrected for the number of comparisons, below which a difference is not chance
RELATED = 4.0
"""Particles that count as one independent draw, since copies of one particle stay related.
Over seeds, the variance of a mean is 0.4 to 1.5 times sd²/ESS for Gaussian, cut and curved targets in four to seven
inputs, and 3.3 times for the weights of two separate modes, which no move mixes. That of the log-evidence is 1.1 to 2.8
times what the weights of the steps give.
"""
MEAN, LOG_SD, SHARE, EVIDENCE = 0.1, 0.1, 0.05, 0.2
"""Smallest differences that matter: means in sd, logarithms of sds, shares of the mass, log-evidence.
The posterior, the mean of the halves, is off by half as much.
"""
SMALLEST = np.finfo(float).tiny
PerHalf = Float[np.ndarray, " half"]
LIKELIHOOD = "log-likelihood"


@dataclass(frozen=True)
class Split:
    """A value `at` of an input, or of the log-likelihood, and the share of the mass up to it in each half."""

    of: str
    at: float
    shares: tuple[float, float]

    @property
    def difference(self) -> float:
        return abs(self.shares[0] - self.shares[1])


@dataclass(frozen=True, eq=False)
class SamplerCheck:
    """How far two independent halves of the particles differ, and how far by chance.

    `mean_difference` is the first less the second mean, in standard deviations, `log_sd_ratio` the logarithm of the
    first over the second standard deviation; an `_error` is the standard deviation by chance. `splits` are those at
    which the shares of the mass differ most, of each input and of the log-likelihood.
    """

    names: tuple[str, ...]
    effective: tuple[float, float]
    mean_difference: Float[np.ndarray, " dim"]
    mean_error: Float[np.ndarray, " dim"]
    log_sd_ratio: Float[np.ndarray, " dim"]
    log_sd_error: Float[np.ndarray, " dim"]
    log_evidence: tuple[float, float]
    log_evidence_error: float
    splits: tuple[Split, ...]

    @property
    def log_evidence_difference(self) -> float:
        return self.log_evidence[0] - self.log_evidence[1]

    @property
    def split(self) -> Split:
        return max(self.splits, key=lambda one: one.difference)

    @property
    def p(self) -> float:
        """Probability that halves of a sampler that works differ as much somewhere, by Bonferroni's inequality."""
        every = np.concatenate(self._p_values)
        return float(min(1.0, len(every) * every.min()))

    @property
    def agree(self) -> bool:
        return not self.differences

    @cached_property
    def differences(self) -> tuple[str, ...]:
        return tuple(self._differences())

    @property
    def verdict(self) -> str:
        """Whether the two halves agree, and by how much they differ, in one sentence."""
        if self.agree:
            return (
                "Two independent halves of the sampler's particles agree: means to "
                f"{np.abs(self.mean_difference).max():.2g} standard deviations, standard deviations to "
                f"{np.expm1(np.abs(self.log_sd_ratio).max()):.1%}, log-evidence to "
                f"{abs(self.log_evidence_difference):.2g}."
            )
        one, other = self.effective
        p = "below 1e-6" if self.p < 1e-6 else f"= {self.p:.1g}"
        return (
            f"Two independent halves of the sampler's particles differ by more than {one:.0f} and {other:.0f} "
            f"effective samples explain (p {p}): {'; '.join(self.differences)}. The posterior is their "
            "union, and may be off by half of that or more. A funnel, a narrow mode beside a wide one or a corner of "
            "the box where particles get stuck does this: take many more particles, and compare."
        )

    def _differences(self) -> Iterator[str]:
        level, (means, sds, shares, evidence) = LEVEL / (3 * len(self.names) + 2), self._p_values
        moved = np.where(means < level, np.abs(self.mean_difference), 0.0)
        if moved.max() > MEAN:
            yield f"means by up to {moved.max():.2f} standard deviations ({self.names[int(np.argmax(moved))]})"
        wider = np.where(sds < level, np.abs(self.log_sd_ratio), 0.0)
        if wider.max() > LOG_SD:
            most = self.names[int(np.argmax(wider))]
            yield f"standard deviations by a factor of up to {np.exp(wider.max()):.2f} ({most})"
        split = self.splits[int(np.argmin(shares))]
        if shares.min() < level and split.difference > SHARE:
            one, other = split.shares
            yield f"{one:.0%} against {other:.0%} of the mass has {split.of} up to {split.at:.4g}"
        if evidence[0] < level and abs(self.log_evidence_difference) > EVIDENCE:
            yield f"log-evidences by {abs(self.log_evidence_difference):.2f}"

    @property
    def _p_values(self) -> tuple[Float[np.ndarray, " _"], ...]:
        """P-values of the means, of the sds, of the shares (Kolmogorov's and Smirnov's test), and of the evidence."""
        one, other = (size / RELATED for size in self.effective)
        distances = np.array([split.difference for split in self.splits])
        return (
            _two_sided(self.mean_difference / self.mean_error),
            _two_sided(self.log_sd_ratio / self.log_sd_error),
            np.asarray(kolmogorov(distances * np.sqrt(one * other / (one + other)))),
            _two_sided(np.array([self.log_evidence_difference / self.log_evidence_error])),
        )


def compare_halves(sampling: SMCResult, posterior: Posterior) -> SamplerCheck | None:
    """Return how the halves of the sampler agree, with the posterior's likelihood; None if it ran as one."""
    if sampling.halves is None:
        return None
    names, draws, number = posterior.space.names, posterior.draws, len(sampling.halves[0].positions)
    parts = [slice(None, number), slice(number, None)]
    weights, evidences = zip(
        *(_reweighted(half, posterior.log_likelihood[part]) for half, part in zip(sampling.halves, parts, strict=True)),
        strict=True,
    )
    one, other = (Weighted(draws[part], w) for part, w in zip(parts, weights, strict=True))
    sizes = [float(1.0 / np.sum(w**2)) for w in weights]
    per_draw = RELATED * sum(1 / size for size in sizes)
    sd = np.maximum(posterior.sd, SMALLEST)
    kurtosis = posterior.weights @ ((draws - posterior.mean) / sd) ** 4
    variance = sum(  # that of independent particles, from the weights of each step
        sum(1 / step.ess - 1 / len(half.positions) for step in half.steps) + 1 / size
        for half, size in zip(sampling.halves, sizes, strict=True)
    )
    columns = [*draws.T, posterior.log_likelihood]
    return SamplerCheck(
        names=tuple(names),
        effective=(sizes[0], sizes[1]),
        mean_difference=(one.mean - other.mean) / sd,
        mean_error=np.full(len(names), np.sqrt(per_draw)),
        log_sd_ratio=np.log(np.maximum(one.sd, SMALLEST) / np.maximum(other.sd, SMALLEST)),
        log_sd_error=np.sqrt(np.maximum(kurtosis - 1.0, 0.1) / 4.0 * per_draw),
        log_evidence=(evidences[0], evidences[1]),
        log_evidence_error=float(np.sqrt(RELATED * variance)),
        splits=tuple(
            _split(name, [column[part] for part in parts], weights)
            for name, column in zip((*names, LIKELIHOOD), columns, strict=True)
        ),
    )


def _reweighted(half: SMCResult, log_likelihood: PerHalf) -> tuple[PerHalf, float]:
    alive = ~np.isneginf(half.log_weights)
    log_weights = np.full(len(alive), -np.inf)
    log_weights[alive] = half.log_weights[alive] + log_likelihood[alive] - half.log_likelihood[alive]
    increment = float(logsumexp(log_weights))
    return np.exp(log_weights - increment), half.log_evidence + increment


def _split(name: str, values: Sequence[PerHalf], weights: Sequence[PerHalf]) -> Split:
    """Return the value at which the weighted distribution functions of two halves are farthest apart."""
    pooled, first = np.concatenate(values), len(values[0])
    order = np.argsort(pooled, kind="stable")
    mine = order < first
    weight = np.concatenate(weights)[order]
    one, other = np.cumsum(np.where(mine, weight, 0.0)), np.cumsum(np.where(mine, 0.0, weight))
    last = np.append(pooled[order][1:] > pooled[order][:-1], True)  # of equal values
    at = int(np.argmax(np.where(last, np.abs(one - other), -1.0)))
    return Split(name, float(pooled[order][at]), (float(min(one[at], 1.0)), float(min(other[at], 1.0))))


def _two_sided(z: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    """Return the probability that a standard normal number is farther from zero."""
    return np.asarray(2.0 * ndtr(-np.abs(z)))
