"""Log evidence and its gradient by (log variance, log lengths) in plain JAX: autodiff of a Cholesky."""

from collections.abc import Mapping
from typing import Any

from worker import Task, serve


def prepare(content: Mapping[str, Any]) -> Task:
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    x, y, nugget = jnp.asarray(content["x"]), jnp.asarray(content["y"]), float(content["nugget"])
    number = len(y)

    @jax.jit
    @jax.value_and_grad
    def evidence(theta: jax.Array) -> jax.Array:
        u = (x * 3**0.5 / jnp.exp(theta[1:])).T
        t = [jnp.abs(column[:, None] - column) for column in u]
        correlation = jnp.exp(-sum(t))
        for distance in t:
            correlation *= 1 + distance
        L = jnp.linalg.cholesky(jnp.exp(theta[0]) * correlation + nugget * jnp.eye(number))
        alpha = jax.scipy.linalg.cho_solve((L, True), y)
        return -0.5 * y @ alpha - jnp.log(jnp.diagonal(L)).sum() - 0.5 * number * jnp.log(2 * jnp.pi)

    theta = jnp.log(jnp.array([content["variance"], *content["lengths"]]))

    def task() -> list[float]:
        value, slope = evidence(theta)
        return [float(value), *map(float, jax.device_get(slope))]

    return task


if __name__ == "__main__":
    serve(("jax",), prepare)
