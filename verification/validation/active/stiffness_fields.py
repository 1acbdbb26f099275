"""A biofilm's field of stiffness from its outline: coverage of its intervals over truths drawn from the prior.

log E is a Gaussian field, sd .5, length .15 mm, of 100 modes; nu is known; points of the outline are seen with a noise
of 1 µm at one or three inflow rates. Printed are, for each truth, runs, seconds, the shares of the field's points, and
whether the mean modulus, lie in their 90 % intervals; at the end their means.

    python -m verification.validation.active.stiffness_fields [--rates 1|3] [--modes 100] [--seeds 10] [--first 0]
        [--mesh default] [--workers 2]
"""

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np

from strandline.calibration import Problem, Settings, calibrate
from strandline.design.active import Active
from strandline.discrepancy import NormalOffset
from strandline.foundations import ForwardModelError, use_double
from strandline.interface import Observation, PointErrors
from strandline.models import WithFields, with_sensitivities
from strandline.models.biofilm import Biofilm
from strandline.parameters import GaussianField, ParameterSpace

RATES = {1: (), 3: (("slow", 25.0), ("middle", 50.0), ("fast", 100.0))}
ERRORS = PointErrors(0.001)
LEVEL = 0.9


def one(seed: int, rates: int, modes: int, mesh: str = "default") -> tuple[int, float, float, bool, bool, str]:
    """Return runs, seconds of the process, share of points covered, whether the mean is, and convergence."""
    use_double()
    plain = Biofilm(mesh=mesh, inflow_rates=RATES[rates])
    field = GaussianField(400.0, 0.5, 0.15, modes=modes).on("E", plain.field_support("E"), "Pa")
    space = ParameterSpace(field.parameters)
    fixed = {"nu": 0.3} | ({"V_in": 100.0} if rates == 1 else {})
    random = np.random.default_rng([31, seed])
    while True:  # a specimen that was seen did not fail
        truth = random.standard_normal(space.dim)
        try:
            seen = WithFields(plain, (field,))(space.as_mapping(truth) | fixed, None).interfaces
            break
        except ForwardModelError:
            continue
    observations = tuple(Observation(ERRORS.draw(at, random), ERRORS, name) for name, at in seen.items())
    model = WithFields(with_sensitivities(plain), (field,))
    problem = Problem(model, space, fixed, observations, {"offset": NormalOffset()})
    begun, wall = time.process_time(), time.time()
    settings = Settings(runs=3, surrogate="field", active=Active(runs=150), seed=seed)
    found = calibrate(problem, settings)
    seconds, wall = time.process_time() - begun, time.time() - wall
    posterior = found.posterior.fields["E"]
    low, high = posterior.interval(LEVEL)
    values = field.values(truth)
    mean = next(iter(posterior.functionals.values()))
    inside = mean.low <= field.support.weights @ values / field.support.weights.sum() <= mean.high
    words = f"{'converged' if found.certificate.converged else 'NOT: ' + found.certificate.reasons[-1]}"
    forward = found.seconds["forward"]
    words += f" forward {forward:.0f} s of {wall:.0f} s, left {posterior.share_left.min():.2f}"
    return (
        len(found.records),
        seconds,
        float(np.mean((low <= values) & (values <= high))),
        bool(inside),
        bool(found.certificate.converged),
        words,
    )


def main() -> None:
    """Print a line for each truth, and their means."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rates", type=int, choices=tuple(RATES), default=1)
    parser.add_argument("--modes", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--mesh", default="default")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    rows = []
    with ProcessPoolExecutor(given.workers, get_context("spawn")) as pool:
        seeds = range(given.first, given.first + given.seeds)
        for seed, row in zip(
            seeds, pool.map(partial(one, rates=given.rates, modes=given.modes, mesh=given.mesh), seeds), strict=True
        ):
            rows.append(row)
            runs, seconds, share, inside, _, words = row
            print(f"{seed}: {runs} runs, {seconds:.0f} CPU-s, covered {share:.1%}, mean {inside}; {words}", flush=True)
    runs, seconds, share, inside, converged, _ = zip(*rows, strict=True)
    print(
        f"{len(rows)} truths: converged {sum(converged)}, runs {np.median(runs):g} (largest {max(runs)}), CPU-s "
        f"{np.median(seconds):.0f} ({max(seconds):.0f}), covered {np.mean(share):.1%}, mean {np.mean(inside):.0%}"
    )


if __name__ == "__main__":
    main()
