"""Warnings about a posterior from a surrogate of the field."""

from collections.abc import Iterator

import numpy as np

from strandline.calibration import Calibration
from strandline.design.active import FieldOutcome
from strandline.likelihood import noise_length

__all__ = ["field_warnings", "likely_to_fail"]

UNSURE = 0.5
"""Error of the interface, in units of the shift that the noise hides, above which a warning counts a nuisance value."""

TENFOLD = np.log(10.0)
"""Logarithm of a ratio of standard deviations above which the number itself says nothing."""
EFFECT = 0.25
"""Largest shift of a mean by the surrogate's variance, in standard deviations, without a warning."""
TOUCHED = 0.05
"""Posterior mass where runs are likely to fail, above which a warning reports it."""


def field_warnings(calibration: Calibration, found: FieldOutcome) -> Iterator[str]:
    """Yield one sentence per doubt."""
    certificate, surrogate = found.certificate, found.knowledge.surrogate
    if certificate is not None and not certificate.converged:
        advice = "" if certificate.scattered else " Allow more runs: design.active.runs."
        yield f"NOT CONVERGED: {'; '.join(certificate.reasons)}.{advice}"
    if certificate is not None and certificate.overlooks:
        yield (
            "There were too few runs to search for other regions that fit as thoroughly as design.active.unseen "
            f"asks. {certificate.statement} Allow more runs: design.active.runs."
        )
    shift, ratio = float(np.abs(found.effect.shift).max()), float(np.abs(np.log(found.effect.sd_ratio)).max())
    if max(shift, ratio) > EFFECT:
        by = f"by up to {np.expm1(ratio):.0%}" if ratio < TENFOLD else "more than tenfold"
        yield (
            f"The surrogate's uncertainty about the interface moves means by up to {shift:.3g} standard deviations "
            f"and changes standard deviations {by}. More runs will lower it."
        )
    yield from likely_to_fail(1.0 - found.feasible)
    checked = None if certificate is None or certificate.checked is None else certificate.checked.check
    if checked is not None and checked.failed:
        yield f"{checked.failed} of {checked.draws} runs at draws of the posterior failed; the check leaves them out."
    yield from _unsure_cut(calibration, found)
    if certificate is not None and certificate.fidelities is not None and certificate.fidelities.dropped is not None:
        yield f"The cheaper model is not used: {certificate.fidelities.dropped}."
    if surrogate.registration_error > surrogate.modes.remainder and surrogate.registration_error > 0:
        yield (
            "The runs' interfaces do not share their nodes and were brought to common points by "
            f"{' and '.join(way for way in surrogate.ways if way != 'nodes')}, which moves them by up to "
            f"{1e3 * surrogate.registration_error:.2g} µm."
        )


def likely_to_fail(share: float) -> Iterator[str]:
    """Yield a sentence if a share worth mentioning of the posterior lies where runs are likely to fail."""
    if share > TOUCHED:
        yield (
            f"{share:.0%} of the posterior lies where runs are likely to fail: what the data say there is not known."
        )


def _unsure_cut(calibration: Calibration, found: FieldOutcome) -> Iterator[str]:
    """Yield a warning if the cut reading goes where there are few runs: they were chosen for the joint reading."""
    if calibration.under_uncertainty is None:
        return
    cut, problem = calibration.under_uncertainty.cut, calibration.problem
    measure = next(iter(problem.discrepancies.values()))
    hidden = min(noise_length(seen, measure) for seen in found.knowledge.likelihood.known_observations)
    errors = found.knowledge.surrogate.predicted_error(cut.extended.draws)
    of_value = np.array([np.median(errors[cut.value_index == k]) for k in range(len(cut.values))])
    unsure = of_value > UNSURE * hidden
    if unsure.any():
        yield (
            f"The cut reading is a guess for {int(unsure.sum())} of its {len(cut.values)} values of the nuisance "
            f"inputs: runs are rare there, and the interface is uncertain by up to {1e3 * of_value.max():.2g} µm where "
            f"the local noise hides {1e3 * hidden:.2g} µm. The joint reading does not depend on them."
        )
