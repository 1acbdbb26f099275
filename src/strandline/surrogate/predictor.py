"""What a surrogate of the log-likelihood must be: a function learnt from runs, with its variance."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput
from strandline.registry import imported

__all__ = ["Fit", "HasHessian", "Predictor", "fit_named"]


@runtime_checkable
class Predictor(Protocol):
    """A function learnt from values at the inputs of runs; a `GaussianProcess` is one.

    All inputs are physical. `HasHessian` describes what else it may offer.
    """

    def mean(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the predicted values."""
        ...

    def variance(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the variances of the predicted values, not negative."""
        ...


@runtime_checkable
class HasHessian(Protocol):
    """A predictor that knows its second derivatives; for others, central differences are used."""

    def hessian(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point dim dim"]:
        """Return the Hessian of the mean."""
        ...


Fit = Callable[[Float[np.ndarray, "run dim"], Float[np.ndarray, " run"]], Predictor]
"""A function that learns from inputs (run, dim) and values (run,)."""


def fit_named(name: str, *, what: str = "name of the surrogate") -> Fit:
    """Return the function ``module:name`` that learns a surrogate; `what` names it in messages.

    Raises:
        InvalidInput: There is no such function.
    """
    found: Any = imported(name, what)
    if not callable(found):
        raise InvalidInput(
            what,
            value=name,
            expected="a function of inputs (run, dim) and log-likelihoods (run,) that returns a surrogate",
            remedy="Check it with strandline.testing.surrogates.",
        )
    return found  # type: ignore[no-any-return]
