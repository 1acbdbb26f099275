"""What a user must be told in words about a posterior by a surrogate of the field."""

from collections.abc import Iterator

import numpy as np

from strandline.active import FieldOutcome
from strandline.calibrate import Calibration

__all__ = ["field_warnings"]

EFFECT = 0.25
"""Standard deviations that the surrogate's variance may move a mean."""
TOUCHED = 0.05
"""Posterior mass where runs are likely to fail that is told."""
APART = 0.5
"""Standard deviations between the two surrogates' means that are told."""


def field_warnings(calibration: Calibration, found: FieldOutcome) -> Iterator[str]:
    """Yield one sentence per doubt."""
    certificate, surrogate = found.certificate, found.knowledge.surrogate
    if certificate is not None and not certificate.converged:
        yield f"NOT CONVERGED: {'; '.join(certificate.reasons)}. Allow more runs: design.active.runs."
    shift, ratio = float(np.abs(found.effect.shift).max()), float(np.abs(np.log(found.effect.sd_ratio)).max())
    if max(shift, ratio) > EFFECT:
        yield (
            f"What the surrogate does not know of the interface moves means by up to {shift:.2f} standard deviations "
            f"and changes standard deviations by up to {np.expm1(ratio):.0%}. More runs will lower it."
        )
    if 1.0 - found.feasible > TOUCHED:
        yield (
            f"{1.0 - found.feasible:.0%} of the posterior lies where runs are likely to fail: what the data say there "
            "is not known."
        )
    checked = None if certificate is None or certificate.checked is None else certificate.checked.check
    if checked is not None and checked.failed:
        yield f"{checked.failed} of {checked.draws} runs at draws of the posterior failed; the check leaves them out."
    if surrogate.registration_error > surrogate.modes.remainder and surrogate.registration_error > 0:
        yield (
            "The runs' interfaces do not share their nodes and were brought to common points by "
            f"{' and '.join(way for way in surrogate.ways if way != 'nodes')}, which moves them by up to "
            f"{1e3 * surrogate.registration_error:.2g} µm."
        )
