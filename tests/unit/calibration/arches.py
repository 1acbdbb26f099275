"""Arches of two inputs that many tests share, a surrogate of them from a few exact runs, and exact posteriors."""

import numpy as np
from scipy.special import logsumexp

from strandline.design import sobol
from strandline.design.active import learn
from strandline.discrepancy import TrackedPoints
from strandline.interface import Interface
from strandline.likelihood import InterfaceLikelihood
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.runs import RunRecord

SPACE = ParameterSpace((Parameter("height", Uniform(0.2, 0.4), "mm"), Parameter("lean", Uniform(-0.1, 0.2))))
TRUTH, SD = np.array([0.3, 0.05]), 0.01
T = np.linspace(0.0, 1.0, 41)
TRACKED = TrackedPoints()


def arches(x, factor=1.0):
    """Return the nodes of arches of some height that lean to one side; `factor` scales what the inputs do."""
    height, lean = 0.3 + factor * (x[:, :1] - 0.3), factor * x[:, 1:]
    y = 4 * height * T * (1 - T) + 0.5 * height**2 * np.sin(2 * np.pi * T)
    return np.stack([T + lean * (1 + height) * np.sin(np.pi * T), y], axis=2)


def arch(x, factor=1.0):
    return Interface.polyline(arches(x[None], factor)[0])


def seen(errors, factor=1.0):
    """Return an arch as it might be observed."""
    return errors.draw(arch(TRUTH, factor), np.random.default_rng(5))


def knowledge(measure, observations, *, runs=24, scramble=3):
    """Return what is learnt of the arches of some conditions, each with its number as the factor: "1", "1.5"."""
    x = SPACE.to_physical(sobol(runs, 2, scramble=scramble))
    records = [
        RunRecord(str(k), SPACE.as_mapping(row), "ok", {name: arch(row, float(name or 1.0)) for name in observations})
        for k, row in enumerate(x)
    ]
    return learn(x, records, SPACE, tuple(observations.values()), measure)


def true_log_likelihood(x, observations, measure=TRACKED):
    """Return log L by the true model: of tracked points at once, of another measure point by point."""
    if measure is TRACKED:
        off = [arches(x, float(o.condition or 1.0)) - o.interface.points for o in observations]
        return -0.5 * sum((d**2).sum(axis=(1, 2)) / o.noise.scale for d, o in zip(off, observations, strict=True))
    likelihood = InterfaceLikelihood(observations, measure)
    return np.array([likelihood({o.condition: arch(row, float(o.condition)) for o in observations}) for row in x])


class Exact:
    """Evidence and moments by Gauss-Legendre quadrature of the true model in the box."""

    def __init__(self, space, observations, measure=TRACKED):
        nodes, weights = np.polynomial.legendre.leggauss(160 if measure is TRACKED else 24)
        grid = np.stack(np.meshgrid(nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 2)
        x = space.low + 0.5 * (grid + 1) * (space.high - space.low)
        log_w = np.log(np.outer(weights, weights).ravel() * np.prod(0.5 * (space.high - space.low)))
        total = log_w + true_log_likelihood(x, observations, measure) + np.asarray(space.log_prior(x))
        self.log_evidence = float(logsumexp(total))
        p = np.exp(total - self.log_evidence)
        self.mean = p @ x
        self.sd = np.sqrt(p @ (x - self.mean) ** 2)
