"""What the model cannot reproduce: a smooth offset along the interface, or an input that differs between conditions.

The offset is a Gaussian process of the arc length with the covariance a² exp(-t/L) (Kennedy and O'Hagan 2001), written
as cosine waves along the interface whose variances are its spectral density (Solin and Särkkä 2020). Half of the prior
probability is on a = 0. The posterior average over a and L then widens where the residuals ask for it, and only there.
It also explains away what inputs could have explained: what they do to the interface must differ from a smooth offset.

The embedded error is an input with a spread (Sargsyan et al. 2015): each condition has its own value, whose standard
deviation τ around the common one is unknown.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from strandline.interface import Interface, Observation, UnknownErrors, arc_lengths, steady_lengths
from strandline.likelihood.linearised import Linearised

__all__ = ["Cause", "Causes", "causes_of", "offset_scales", "offset_waves"]

WAVES = 12
"""Number of waves along the interface."""
AMPLITUDES = np.geomspace(0.3, 10.0, 6)
"""Amplitudes a compared, in root mean squares of the residuals."""
LENGTHS = (0.05, 0.15, 0.5)
"""Lengths L compared, as shares of the length of the interface."""
SPREADS = (0.02, 0.05, 0.1, 0.25, 0.5)
"""Standard deviations τ compared, as shares of that of a uniform prior over the box."""


@dataclass(frozen=True)
class Cause:
    """An error of the model: amplitude a of the offset, mm, its length as a share of the interface's, and τ.

    All zero (but for the length) if the model is right.
    """

    amplitude: float = 0.0
    share: float = 1.0
    spread: float = 0.0


@dataclass(frozen=True, eq=False)
class Causes:
    """Errors of the model to compare, the first of which is none, and what they do to the residuals.

    Args:
        compared: The errors.
        columns: What the waves, and deviations of inputs in each condition, do to the signed distances, mm.
        scales: Standard deviations of these for each error, shape (cause, column).
    """

    compared: tuple[Cause, ...]
    columns: Float[np.ndarray, "seen column"]
    scales: Float[np.ndarray, "cause column"]


def causes_of(lin: Linearised, observations: Sequence[Observation], unknown: UnknownErrors) -> Causes:
    """Return the errors of the model that are to be considered."""
    interfaces = [o.interface for o in observations]
    rms = float(np.sqrt(np.mean(lin.residuals**2))) or 1e-9
    offsets = [(a * rms, share) for a in AMPLITUDES for share in LENGTHS] if unknown.model_error else []
    spreads = SPREADS if unknown.spread else ()
    compared = [Cause(), *(Cause(a, share) for a, share in offsets), *(Cause(spread=tau) for tau in spreads)]
    compared += [Cause(a, share, tau) for a, share in offsets for tau in spreads]
    waves = block_diag(*[offset_waves(one) for one in interfaces]) if offsets else np.empty((len(lin.residuals), 0))
    ends = np.cumsum([len(one.points) for one in interfaces])
    chosen = lin.scaled[:, list(unknown.spread)]
    each = block_diag(*np.split(chosen, ends[:-1])) if spreads else np.empty((len(lin.residuals), 0))
    scales = [
        np.concatenate(
            [
                *([offset_scales(one, cause.amplitude, cause.share) for one in interfaces] if offsets else []),
                np.full(each.shape[1], cause.spread),
            ]
        )
        for cause in compared
    ]
    return Causes(tuple(compared), np.hstack([waves, each]), np.array(scales))


def offset_waves(seen: Interface) -> Float[np.ndarray, "point wave"]:
    """Return waves cos(πjt) at the observed points, t the share of the arc length; on a closed one sines too."""
    t = arc_lengths(seen) / float(steady_lengths(seen).sum())
    if seen.closed:
        angle = 2 * np.pi * t[:, None] * np.arange(WAVES // 2 + 1)
        return np.concatenate([np.cos(angle), np.sin(angle[:, 1:])], axis=1)
    return np.cos(np.pi * t[:, None] * np.arange(WAVES))


def offset_scales(seen: Interface, amplitude: float, share: float) -> Float[np.ndarray, " wave"]:
    """Return the standard deviation of each wave for an amplitude a, mm, and a length L, a share of the interface's."""
    each = np.arange(WAVES // 2 + 1)
    number = 2 * np.concatenate([each, each[1:]]) if seen.closed else np.arange(WAVES)
    density = 2 * share / (1 + (math.pi * number * share) ** 2)
    norm = np.where(number == 0, 1.0, 2.0)
    return np.asarray(amplitude * np.sqrt(norm * density))
