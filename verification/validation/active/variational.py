"""Variational Gaussians for the field of a strip: solves until their bound settles, and how wrong they are.

BlackJAX stands in for QUEENS (`RPVI`, with which `BMFIA` ends), which pip cannot install: a Gaussian of full rank or of
independent coefficients, Adam, exact gradients, a start at the prior. Rate and draws of a step are as in QUEENS' tests
(0.02 to 0.05; 2 to 10), without its natural gradient. Truths, seeds and the chains on the true model are as in
`.strips`. A bound has settled when its mean over 1000 solves is less than 0.5 above that of the 1000 before. Printed
are the largest errors of the field's mean, in sds, and of its sd. With `--decay` the rate falls to 0 at the last solve.

    python -m verification.validation.active.variational [--dims 10 20] [--solves 20000] [--rate 0.02] [--decay]
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product
from typing import Any

import blackjax
import jax
import jax.numpy as jnp
import numpy as np
import optax
from verification.validation.active.strips import BENDING, NOISE, Coefficients, Strip, Truth, observed

from strandline.foundations import use_double
from strandline.posterior import Weighted

FAMILIES = {"independent": blackjax.meanfield_vi, "full rank": blackjax.fullrank_vi}
MARKS = (500, 2_000, 10_000)
WINDOW, RISE, KEPT = 1_000, 0.5, 20_000


@dataclass(frozen=True)
class Fit:
    """Draws of a variational Gaussian after some solves, and the mean of its bound over the latest ones."""

    solves: int
    bound: float
    draws: Coefficients


def fits(truth: Truth, family: str, seed: int, given: argparse.Namespace) -> Iterator[Fit]:
    """Yield the fit after each window of solves, and at the marks."""
    modes, bending = jnp.asarray(truth.strip.field.modes), jnp.asarray(BENDING)

    def density(xi: jax.Array) -> jax.Array:
        misfit = (bending @ jnp.exp(-modes @ xi) - truth.seen) / NOISE
        return -0.5 * (misfit @ misfit + xi @ xi)

    each = given.draws
    rate = optax.cosine_decay_schedule(given.rate, given.solves // each) if given.decay else given.rate
    method = FAMILIES[family](density, optax.adam(rate), each)
    state = method.init(jnp.zeros(truth.strip.dim))
    if family == "independent":
        state = state._replace(rho=state.mu)

    @partial(jax.jit, static_argnums=2)
    def steps(key: jax.Array, state: Any, number: int) -> tuple[Any, jax.Array]:
        def step(state: Any, key: jax.Array) -> tuple[Any, jax.Array]:
            state, info = method.step(key, state)
            return state, -info.elbo  # BlackJAX's `elbo` is the loss, minus the bound

        return jax.lax.scan(step, state, jax.random.split(key, number))

    key, done, bounds = jax.random.key(seed), 0, np.zeros(0)
    for solves in sorted({*MARKS, *range(WINDOW, given.solves + 1, WINDOW)}):
        key, at = jax.random.split(key)
        state, new = steps(at, state, (solves - done) // each)
        bounds, done = np.append(bounds, new), solves
        draws = np.asarray(method.sample(jax.random.fold_in(at, 1), state, KEPT))
        yield Fit(solves, float(bounds[-WINDOW // each :].mean()), draws)


def settled(course: list[Fit]) -> Fit | None:
    """Return the first fit whose bound has hardly risen, if there is one."""
    whole = pairwise(fit for fit in course if fit.solves % WINDOW == 0)
    return next((new for old, new in whole if new.bound - old.bound < RISE), None)


def compared(fit: Fit, true: Weighted, modes: np.ndarray) -> str:
    """Return the errors of a fit as words."""
    z = fit.draws @ modes.T
    off, ratio = np.abs((z.mean(axis=0) - true.mean) / true.sd).max(), z.std(axis=0) / true.sd
    wide, least, most = np.abs(ratio - 1).max(), ratio.min(), ratio.max()
    return f"{off:.2f}, {wide:.2f} (sds {least:.2f} to {most:.2f}; bound {fit.bound:.4g})"


def one(seed: int, dim: int, given: argparse.Namespace) -> Iterator[str]:
    """Yield what the families find, as lines."""
    strip = Strip(dim)
    truth = Truth(strip, observed(strip, seed))
    courses = {family: list(fits(truth, family, seed, given)) for family in FAMILIES}
    draws = np.concatenate([course[-1].draws for course in courses.values()])
    start = draws[np.argsort(truth.log_likelihood(draws) - 0.5 * (draws**2).sum(axis=1))[-480::10]]
    true = truth.by_chains(start, np.random.default_rng(seed))
    for family, course in courses.items():
        yield f"d {dim} seed {seed} {family}: mean off, sd"
        shown = [("settled", settled(course)), *(("at", fit) for fit in course if fit.solves in (*MARKS, given.solves))]
        yield from (f"    {word} {fit.solves}: {compared(fit, true, strip.field.modes)}" for word, fit in shown if fit)


def main() -> None:
    """Print the lines of each strip."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--dims", type=int, nargs="+", default=[10, 20, 50, 100])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--solves", type=int, default=20_000)
    parser.add_argument("--rate", type=float, default=0.02)
    parser.add_argument("--decay", action="store_true")
    parser.add_argument("--draws", type=int, default=10)
    given = parser.parse_args()
    use_double()
    for dim, seed in product(given.dims, range(given.seeds)):
        for line in one(seed, dim, given):
            print(line, flush=True)


if __name__ == "__main__":
    main()
