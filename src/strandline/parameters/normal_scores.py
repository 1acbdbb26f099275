"""The inputs as functions of u, standard normal a priori: a bounded prior needs no walls there."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

from strandline.parameters.parameter_space import ParameterSpace
from strandline.parameters.priors import Prior

EDGE = 1e-12  # least share of a prior beyond a point

Points = Float[np.ndarray, "point dim"]


@dataclass(frozen=True, eq=False)
class NormalScores:
    """Inputs ↔ u, correlated ones by their copula."""

    space: ParameterSpace

    def inputs(self, u: Points) -> Points:
        """Return the inputs at points u."""
        q = ndtr(u @ self.space.root.T)
        x = np.empty_like(q)
        for prior, columns in self._alike:
            x[:, columns] = prior.quantile(np.clip(q[:, columns], EDGE, 1 - EDGE).ravel()).reshape(len(q), -1)
        return np.asarray(x)

    def places(self, x: Points) -> Points:
        return np.asarray(ndtri(np.clip(self.space.prior_shares(x), EDGE, 1 - EDGE)))

    def pulled(self, by_inputs: Float[np.ndarray, "row dim"], u: Points, x: Points) -> Float[np.ndarray, "row dim"]:
        """Return derivatives by u, given those by the inputs: of each point, or several of one."""
        q, logs = u @ self.space.root.T, np.empty_like(u)
        for prior, columns in self._alike:
            logs[:, columns] = np.asarray(prior.log_density(x[:, columns].ravel())).reshape(len(u), -1)
        return np.asarray((by_inputs * np.exp(-0.5 * q**2 - logs) / np.sqrt(2 * np.pi)) @ self.space.root)

    @cached_property
    def _alike(self) -> list[tuple[Prior, list[int]]]:
        """The different priors, and the inputs that have each."""
        found: dict[Prior, list[int]] = {}
        for k, one in enumerate(self.space):
            found.setdefault(one.truncated_prior, []).append(k)
        return list(found.items())
