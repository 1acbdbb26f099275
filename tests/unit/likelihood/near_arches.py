"""Likelihoods of arches through surrogates that tests of what happens near the best fit share."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.unit.calibration.arches import SD, SPACE, TRUTH, arch, knowledge, seen

from strandline.discrepancy import Discrepancy, JointErrors, NormalOffset
from strandline.interface import GaussianNoise, Interface, Observation, PointErrors, UnknownErrors
from strandline.likelihood import FieldLikelihood
from strandline.likelihood.linearised_residuals import NearField, linearise
from strandline.likelihood.local_likelihood import OfStatedErrors

LOCAL = PointErrors(SD)
GLOBAL = PointErrors(SD, 0.05, shift=0.02, rotation=1.0, scale=0.01, offset=0.01)
ALL = [pytest.param(LOCAL, id="local"), pytest.param(GLOBAL, id="global")]


@cache
def likelihood(errors: PointErrors | UnknownErrors) -> FieldLikelihood:
    known = errors if isinstance(errors, PointErrors) else LOCAL
    return knowledge(NormalOffset(), {"": Observation(seen(known), errors)}).likelihood


def joint(errors: PointErrors) -> JointErrors:
    return JointErrors(likelihood(errors).observations, (errors,))


def near(errors: PointErrors) -> NearField:
    found = likelihood(errors).nearby
    assert isinstance(found, OfStatedErrors)
    return found.field


def widened(found: FieldLikelihood, widening: float) -> FieldLikelihood:
    """Return the likelihood with all variances of the surrogate times this factor."""
    processes = tuple(replace(one, widening=widening) for one in found.surrogate.processes)
    return replace(found, surrogate=replace(found.surrogate, processes=processes))


def around(errors: PointErrors, number: int = 20) -> np.ndarray:
    """Return inputs where the posterior lies."""
    lin = linearise(likelihood(errors).surrogate, joint(errors))
    step = np.random.default_rng(5).multivariate_normal(np.zeros(2), lin.covariance(joint(errors).model), number)
    return np.clip(lin.at + step, SPACE.low, SPACE.high)


@cache
def by(measure: Discrepancy, hidden: float = 0.002) -> FieldLikelihood:
    """Return a likelihood by this measure, whose noise hides a shift of this size."""
    shift = arch(TRUTH).points + np.array([0.0, hidden])
    noise = GaussianNoise(measure(Interface(shift, arch(TRUTH).cells), arch(TRUTH)))
    return knowledge(measure, {"": Observation(arch(TRUTH), noise)}).likelihood
