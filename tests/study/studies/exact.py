"""Posteriors of the beam by sums over a grid with the model itself: no surrogate, no sampler; and a cheaper beam."""

from pathlib import Path

import numpy as np
from scipy.special import logsumexp

from strandline.likelihood import InterfaceLikelihood
from strandline.testing.studies import beam

MIDDLES = (np.arange(21) + 0.5) / 21
E, TILT = 300 + 260 * MIDDLES, 0.04 * MIDDLES
GRID = np.stack([a.ravel() for a in np.meshgrid(E, TILT, indexing="ij")], axis=1)
X = np.linspace(0, 1, 17)


def tracked(E, tilt):
    """Return the log-likelihood of tracked points with σ_N = 3 µm, written out."""
    apart = (20 / E - 20 / 400) * X**2 * (3 - X) + (tilt - 0.02) * X
    return float(-0.5 * np.sum(apart**2) / 0.003**2)


def likelihood_of(problem):
    likelihood = InterfaceLikelihood(problem.observations, problem.measure)
    return lambda E, tilt: likelihood({"": beam({"E": E, "tilt": tilt, "load": 1e-5}, Path()).interface})


def moments(log_weights, values):
    weights = np.exp(log_weights - logsumexp(log_weights))
    mean = float(weights @ values)
    return mean, float(np.sqrt(weights @ (values - mean) ** 2))


def posterior(log_likelihood):
    """Return mean and standard deviation by input, and the log-evidence, under uniform priors."""
    values = np.array([log_likelihood(*row) for row in GRID.tolist()])
    found = {name: moments(values, column) for name, column in zip(("E", "tilt"), GRID.T, strict=True)}
    return found, float(logsumexp(values) - np.log(len(values)))


class Softer:
    """A cheaper model: the beam with a modulus that is too small by a tenth."""

    fingerprint = "test:softer-beam"
    inputs = beam.inputs

    def __call__(self, inputs, workdir):
        return beam({**inputs, "E": 0.9 * inputs["E"]}, workdir)


softer = Softer()
