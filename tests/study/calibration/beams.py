"""A beam whose posterior is known by sums over its closed form, and drafts of its calibration."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import logsumexp

from strandline.calibration import Observer, Problem, Settings, calibrate
from strandline.calibration.learning import Learning
from strandline.calibration.problem import Stopwatch
from strandline.design.active import Active
from strandline.discrepancy import TrackedPoints
from strandline.interface import Observation
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.runs import InProcess, Ledger
from strandline.smc import SMCSettings
from strandline.testing.studies import beam

TRUTH = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
X = np.linspace(0.0, 1.0, 17)
NOISE = 0.006
ONE = ParameterSpace((Parameter("E", Uniform(300.0, 560.0), "Pa"),))
TWO = ParameterSpace((Parameter("E", Uniform(200.0, 800.0), "Pa"), Parameter("tilt", Uniform(-0.05, 0.1))))
SMC = SMCSettings(rejuvenation_steps=6, zeta=0.5)
SETTINGS = Settings(runs=32, particles=1000, smc=SMC, draft=True)
ACTIVE = Settings(runs=8, particles=1000, smc=SMC, surrogate="field", active=Active(80, batch=4), draft=True)


def problem(*, space=TWO, model=beam, noise=NOISE, measure=None, **more):
    observation = Observation(beam(TRUTH, Path()).interface, noise**2)
    fixed = {name: value for name, value in TRUTH.items() if name not in space.names}
    return Problem(model, space, fixed, (observation,), {"tracked": measure or TrackedPoints(), **more})


def answer(folder, asked, settings=ACTIVE, **options):
    options.setdefault("executor", InProcess())
    with Ledger.open(folder / "ledger.sqlite", model=asked.model) as ledger:
        return calibrate(asked, settings, ledger=ledger, **options)


def learnt(folder, asked, settings):
    """Return what all runs teach, without a posterior."""
    folder.mkdir(exist_ok=True)
    with Ledger.open(folder / "ledger.sqlite", model=asked.model) as ledger:
        return Learning(asked, settings, ledger, InProcess(), Observer(), Stopwatch()).train(None)


@dataclass(frozen=True)
class Exact:
    """Mean, standard deviation and log-evidence."""

    mean: np.ndarray
    sd: np.ndarray
    log_evidence: float

    def off(self, found):
        """Return the largest errors of a mean, in sd, of an sd, relative, and of the log-evidence."""
        posterior = found.posterior
        shift, width = np.abs(posterior.mean - self.mean) / self.sd, np.abs(posterior.sd / self.sd - 1)
        return float(shift.max()), float(width.max()), abs(posterior.log_evidence - self.log_evidence)

    def assert_off(self, found, mean, sd, log_evidence=np.inf):
        """Compare with a posterior, of which these are the largest errors that are allowed."""
        assert (np.array(self.off(found)) < (mean, sd, log_evidence)).all(), self.off(found)


def summed(points, log_likelihood):
    """Return the posterior by a sum over points that are even in the prior."""
    weights = np.exp(log_likelihood - logsumexp(log_likelihood))
    mean = weights @ points
    sd = np.sqrt(weights @ (points - mean) ** 2)
    return Exact(mean, sd, float(logsumexp(log_likelihood) - np.log(len(points))))


def exact(space=TWO, noise=NOISE):
    """Return the posterior by tracked points of the beam that `problem` observes."""
    E = np.linspace(space.low[0], space.high[0], 241)
    tilt = np.linspace(space.low[1], space.high[1], 161) if space.dim == 2 else np.array([TRUTH["tilt"]])
    points = np.stack(np.meshgrid(E, tilt, indexing="ij"), axis=-1).reshape(-1, 2)
    y = 20.0 / points[:, :1] * X**2 * (3 - X) + points[:, 1:] * X
    squares = np.sum((y - (0.05 * X**2 * (3 - X) + TRUTH["tilt"] * X)) ** 2, axis=1)
    return summed(points[:, : space.dim], -0.5 * squares / noise**2)
