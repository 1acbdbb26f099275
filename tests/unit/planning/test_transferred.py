"""The interface in another experiment from one run of it, on a displacement with a closed form."""

from functools import cache

import numpy as np

from strandline.design import sobol
from strandline.interface import Interface
from strandline.planning.transferred import Transferred, transfer
from strandline.surrogate.field import FieldSurrogate, FieldTraining, fit_field

LOW, HIGH = np.array([100.0, -0.8]), np.array([800.0, 0.5])
S = np.linspace(0.0, 1.0, 25)
AT = np.array([400.0, 0.2])
COVARIANCE = np.array([[900.0, 2.0], [2.0, 0.01]])


def fields(x: np.ndarray, load: float) -> np.ndarray:
    """Return displacements across: one shape that softens with the load, one that depends on ν."""
    share, nu = load / x[:, :1], x[:, 1:]
    bent = (share + 2 * share**2) * np.sin(np.pi * S) + share * np.exp(1.5 * nu) * np.sin(2 * np.pi * S)
    return np.stack([np.broadcast_to(S, bent.shape), bent], axis=-1).reshape(len(x), -1)


def slopes(load: float) -> np.ndarray:
    step = np.diag([1e-2, 1e-5])
    both = fields(AT + step, load) - fields(AT - step, load)
    return np.asarray((both / (2 * np.diag(step)[:, None])).T)


@cache
def surrogate() -> FieldSurrogate:
    x = LOW + (HIGH - LOW) * sobol(40, 2, scramble=1)
    runs = [{"": Interface.polyline(row.reshape(-1, 2))} for row in fields(x, 40.0)]
    return fit_field(FieldTraining(x, runs, None, LOW, HIGH))


def there(load: float) -> Transferred:
    return transfer(surrogate(), AT, fields(AT[None], load)[0], slopes(load), COVARIANCE)


DRAWS = np.random.default_rng(1).multivariate_normal(AT, COVARIANCE, 200)


def off(found: np.ndarray, load: float) -> float:
    """Return the root mean square error, in the spread of the true fields."""
    true = fields(DRAWS, load)
    return float(np.sqrt(np.mean((found - true) ** 2) / np.mean((true - true.mean(axis=0)) ** 2)))


def test_one_run_predicts_the_interface_under_another_load() -> None:
    """At the inputs of the run it is the run itself, with its slopes."""
    step = np.diag([1.0, 1e-3])
    for load, most in ((20.0, 0.02), (40.0, 2e-3), (60.0, 0.03)):
        one = there(load)
        found = one.fields(DRAWS)
        assert off(found, load) < most
        linear = fields(AT[None], load) + (DRAWS - AT) @ slopes(load).T
        assert off(linear, load) > 3 * off(found, load)
        np.testing.assert_allclose(one.fields(AT[None])[0], fields(AT[None], load)[0], atol=1e-12)
        near = (one.fields(AT + step) - one.fields(AT - step)) / (2 * np.diag(step)[:, None])
        largest = np.abs(slopes(load)).max(axis=0)
        np.testing.assert_allclose(near.T / largest, slopes(load) / largest, atol=2e-3)
