"""Log evidence and its gradient by (log variance, log lengths) with GPJax: product of Matérn 3/2, noise fixed."""

from collections.abc import Mapping
from typing import Any

from worker import Task, serve


def prepare(content: Mapping[str, Any]) -> Task:
    import gpjax as gpx
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    x, y, noise = jnp.asarray(content["x"]), jnp.asarray(content["y"])[:, None], float(content["nugget"]) ** 0.5
    data = gpx.Dataset(X=x, y=y)

    @jax.jit
    @jax.value_and_grad
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

    theta = jnp.log(jnp.array([content["variance"], *content["lengths"]]))

    def task() -> list[float]:
        value, slope = evidence(theta)
        return [float(value), *map(float, jax.device_get(slope))]

    return task


if __name__ == "__main__":
    serve(("gpjax", "jax"), prepare)
