"""Log evidence and its gradient by (log variance, log lengths): product of Matérn 3/2, noise fixed, by one program.

Call: ``python evidence.py PROGRAM TASK.npz``; each function below makes the task of the program of its name.
"""

import math
import os
import sys
from collections.abc import Mapping
from typing import Any

from worker import CORES, Task, serve

Content = Mapping[str, Any]


def strandline(content: Content) -> Task:
    """Compute it as a fit of strandline does dozens of times."""
    import numpy as np

    from strandline.surrogate import KERNELS
    from strandline.surrogate.hyperparameters import Objective

    objective = Objective(content["x"], content["y"], KERNELS["matern32_product"], float(content["nugget"]))
    log_lengths = np.log(content["lengths"])
    log_ratio = math.log(content["variance"]) - 3 * log_lengths.mean()

    def task() -> list[float]:
        found = objective.evidence(float(log_ratio), log_lengths.tolist())
        by_variance, by_lengths = found.gradient[0], found.gradient[1:]
        return [found.value, by_variance, *(by_lengths - 3 / len(log_lengths) * by_variance)]

    return task


def by_jax(content: Content, evidence: Any) -> Task:
    """Return the value and the gradient of a function of (log variance, log lengths)."""
    import jax
    import jax.numpy as jnp

    both = jax.jit(jax.value_and_grad(evidence))
    theta = jnp.log(jnp.array([content["variance"], *content["lengths"]]))

    def task() -> list[float]:
        value, slope = both(theta)
        return [float(value), *map(float, jax.device_get(slope))]

    return task


def jax(content: Content) -> Task:
    """Differentiate a Cholesky decomposition in plain JAX."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    x, y, nugget = jnp.asarray(content["x"]), jnp.asarray(content["y"]), float(content["nugget"])
    number = len(y)

    def evidence(theta: jax.Array) -> jax.Array:
        u = (x * 3**0.5 / jnp.exp(theta[1:])).T
        t = [jnp.abs(column[:, None] - column) for column in u]
        correlation = jnp.exp(-sum(t))
        for distance in t:
            correlation *= 1 + distance
        L = jnp.linalg.cholesky(jnp.exp(theta[0]) * correlation + nugget * jnp.eye(number))
        alpha = jax.scipy.linalg.cho_solve((L, True), y)
        return -0.5 * y @ alpha - jnp.log(jnp.diagonal(L)).sum() - 0.5 * number * jnp.log(2 * jnp.pi)

    return by_jax(content, evidence)


def gpjax(content: Content) -> Task:
    """Use GPJax's conjugate marginal likelihood."""
    import gpjax as gpx
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    x, y, noise = jnp.asarray(content["x"]), jnp.asarray(content["y"])[:, None], float(content["nugget"]) ** 0.5
    data = gpx.Dataset(X=x, y=y)

    def evidence(theta: jax.Array) -> jax.Array:
        variances = [jnp.exp(theta[0])] + [jnp.ones(())] * (x.shape[1] - 1)
        factors = [
            gpx.kernels.Matern32(active_dims=[d], n_dims=1, lengthscale=jnp.exp(theta[1 + d]), variance=variance)
            for d, variance in enumerate(variances)
        ]
        kernel = gpx.kernels.ProductKernel(kernels=factors)
        prior = gpx.gps.Prior(kernel=kernel, mean_function=gpx.mean_functions.Zero(), jitter=0.0)
        model = prior * gpx.likelihoods.Gaussian(obs_stddev=jnp.asarray(noise))
        return gpx.objectives.conjugate_mll(model, data)

    return by_jax(content, evidence)


def gpytorch(content: Content) -> Task:
    """Use a Cholesky decomposition: GPyTorch's iterative approximations are switched off."""
    import gpytorch
    import torch

    torch.set_num_threads(int(os.environ.get(CORES, "1")))
    x, y = torch.from_numpy(content["x"]), torch.from_numpy(content["y"])
    factors = [gpytorch.kernels.MaternKernel(nu=1.5, active_dims=[d]).double() for d in range(x.shape[1])]
    kernel = gpytorch.kernels.ScaleKernel(gpytorch.kernels.ProductKernel(*factors)).double()
    for factor, length in zip(factors, content["lengths"], strict=True):
        factor.lengthscale = float(length)
    kernel.outputscale = float(content["variance"])
    likelihood = gpytorch.likelihoods.GaussianLikelihood().double()
    likelihood.noise = float(content["nugget"])
    likelihood.raw_noise.requires_grad_(False)

    class Process(gpytorch.models.ExactGP):
        def __init__(self) -> None:
            super().__init__(x, y, likelihood)
            self.mean_module, self.covar_module = gpytorch.means.ZeroMean(), kernel

        def forward(self, points: torch.Tensor) -> Any:
            return gpytorch.distributions.MultivariateNormal(self.mean_module(points), self.covar_module(points))

    process = Process().double().train()
    marginal = gpytorch.mlls.ExactMarginalLogLikelihood(likelihood, process)
    raw = [kernel.raw_outputscale, *(factor.raw_lengthscale for factor in factors)]

    def task() -> list[float]:
        for parameter in raw:
            parameter.grad = None
        with (
            gpytorch.settings.fast_computations(covar_root_decomposition=False, log_prob=False, solves=False),
            gpytorch.settings.max_cholesky_size(10**9),
            gpytorch.settings.cholesky_jitter(double_value=0.0),
        ):
            value = len(y) * marginal(process(x), y)
        value.backward()
        return [float(value.detach()), *(by_logarithm(parameter) for parameter in raw)]

    def by_logarithm(parameter: torch.nn.Parameter) -> float:
        """Return d/d log softplus(r) from d/dr."""
        soft = torch.nn.functional.softplus(parameter.detach())
        return float(parameter.grad * soft / torch.sigmoid(parameter.detach()))

    return task


PROGRAMS = {
    "strandline": (strandline, ("strandline", "numpy", "scipy")),
    "jax": (jax, ("jax",)),
    "gpjax": (gpjax, ("gpjax", "jax")),
    "gpytorch": (gpytorch, ("gpytorch", "torch")),
}

if __name__ == "__main__":
    prepare, packages = PROGRAMS[sys.argv[1]]
    serve(packages, prepare)
