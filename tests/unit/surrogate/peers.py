"""Data for Gaussian processes, and scikit-learn's form of every kernel.

scikit-learn has no products by input; a Matérn kernel that is flat in all inputs but one is a kernel of that input
alone, and the product of such kernels is ours.
"""

from functools import reduce
from operator import mul

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern

from strandline.design import sobol
from strandline.surrogate import KERNELS, condition
from strandline.surrogate.gaussian_process import standardisation
from strandline.surrogate.kernels import as_length_scale

LENGTHS, VARIANCE, NUGGET = np.array([0.8, 2.5, 1.3, 4.0]), 2.3, 1e-3
FLAT = 1e9
FAMILIES = {
    "matern32": lambda length: Matern(length, nu=1.5),
    "matern52": lambda length: Matern(length, nu=2.5),
    "squared_exponential": RBF,
}
FORMS = {family: [name for name in KERNELS if name.startswith(family)] for family in FAMILIES}
EVERY = pytest.mark.parametrize("names", FORMS.values(), ids=list(FORMS))
"""One case a family, over all of its forms."""


def lengths_of(name, dim):
    return LENGTHS[: dim if KERNELS[name].per_input else 1]


def hyperparameters(name, dim):
    length_scale = as_length_scale(KERNELS[name], lengths_of(name, dim))
    return {"kernel": KERNELS[name], "length_scale": length_scale, "signal_variance": VARIANCE, "nugget": NUGGET}


def peers_correlation(name, lengths):
    """Return scikit-learn's kernel; `lengths` are one, or one for each input."""
    one = FAMILIES[name.removesuffix("_ard").removesuffix("_product")]
    if name.endswith("_product"):
        rows = zip(np.eye(len(lengths)), lengths, strict=True)
        return reduce(mul, [one(np.where(row > 0, length, FLAT)) for row, length in rows])
    return one(lengths if name.endswith("_ard") else float(lengths[0]))


def peer(name, dim):
    """Return scikit-learn's process with the same hyperparameters."""
    kernel = ConstantKernel(VARIANCE) * peers_correlation(name, lengths_of(name, dim))
    return GaussianProcessRegressor(kernel, alpha=NUGGET, optimizer=None)


def runs(number=60, dim=3, seed=0):
    """Return physical inputs of unlike sizes, and targets."""
    rng = np.random.default_rng(seed)
    x = np.linspace(-5, 5, dim) + rng.random((number, dim)) * np.logspace(2, -2, dim)
    u = (x - x.mean(axis=0)) / x.std(axis=0)
    return x, np.sin(2 * u[:, 0]) + np.cos(u.sum(axis=1)) - 3 * u[:, -1] ** 2


def conditioned(name="matern32", dim=3, **options):
    x, y = runs(dim=dim)
    return x, y, condition(x, y, **{**hyperparameters(name, dim), **options})


def standardised(number, dim):
    u = sobol(number, dim)
    shift, scale = standardisation(u)
    y = np.cos(5 * u[:, 0]) + 4 * (u**2).sum(axis=1)
    return (u - shift) / scale, y - y.mean()


def drawn(name, number, lengths, nugget, seed):
    """Return standardised inputs and one draw of a process of variance 2, its covariance from scikit-learn."""
    x, _ = standardised(number, 2)
    K = 2.0 * peers_correlation(name, np.array(lengths))(x) + nugget * np.eye(number)
    return x, np.linalg.cholesky(K) @ np.random.default_rng(seed).standard_normal(number)
