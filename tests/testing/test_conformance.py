"""The conformance suites run over the registries, so that a new entry is tested by being registered; and they fail."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pytest

from strandline.discrepancy import DISCREPANCIES
from strandline.interface import NOISES, GaussianNoise, Interface
from strandline.priors import PRIORS, Normal, Uniform
from strandline.testing import discrepancies, noise, priors

NUMBERS = {"beta": (2.6, 1.4, 0.0, 110.0), "lognormal": (5.86, 0.4), "normal": (3.0, 2.0), "uniform": (100.0, 800.0)}
OPTIONS = {"currents": {"width": 0.05}}


def options_of(kind: type) -> dict[str, Any]:
    """Return a positive number for every option without a default."""
    from dataclasses import MISSING

    return {f.name: 0.05 for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING}


@pytest.mark.parametrize("check", noise.CHECKS.values(), ids=noise.CHECKS)
@pytest.mark.parametrize("name", NOISES)
def test_every_noise_model(name: str, check: Any) -> None:
    check(NOISES[name](**options_of(NOISES[name])))


@pytest.mark.parametrize("check", priors.CHECKS.values(), ids=priors.CHECKS)
@pytest.mark.parametrize("name", PRIORS)
def test_every_prior(name: str, check: Any) -> None:
    check(PRIORS[name](*NUMBERS.get(name, (1.0, 2.0))))


@pytest.mark.parametrize("check", discrepancies.CHECKS.values(), ids=discrepancies.CHECKS)
@pytest.mark.parametrize("name", DISCREPANCIES)
def test_every_discrepancy(name: str, check: Any) -> None:
    check(DISCREPANCIES[name](**(OPTIONS.get(name) or options_of(DISCREPANCIES[name]))))


def complaints(checks: Mapping[str, Any], wrong: Any) -> str:
    """Return what the checks of a suite say of an entry."""
    said = []
    for check in checks.values():
        try:
            check(wrong)
        except AssertionError as error:
            said.append(str(error))
    return "; ".join(said)


@dataclass(frozen=True)
class Forgetful(GaussianNoise):
    """Its constant does not count the residuals."""

    def constant(self, terms: int) -> float:
        return -0.5 * math.log(2 * math.pi * self.variance)


@dataclass(frozen=True)
class Doubled(GaussianNoise):
    """It counts the misfit twice."""

    def log_density(self, squared: np.ndarray) -> np.ndarray:
        return np.asarray(-squared / self.variance)


@pytest.mark.parametrize(("wrong", "words"), [(Forgetful(2.0), "constant"), (Doubled(2.0), "not 0.5")])
def test_a_wrong_noise_model_is_noticed(wrong: GaussianNoise, words: str) -> None:
    assert re.search(words, complaints(noise.CHECKS, wrong))


class Wide(Uniform):
    """Its density belongs to a box of twice the width."""

    def log_density(self, x: Any) -> Any:
        return super().log_density(x) - math.log(2.0)


class Shifted(Normal):
    """Its quantiles are those of another mean."""

    def quantile(self, p: Any) -> Any:
        return super().quantile(p) + 1.0


@pytest.mark.parametrize(("wrong", "words"), [(Wide(0.0, 1.0), "integrates to 0.49"), (Shifted(0.0, 1.0), "is not p")])
def test_a_wrong_prior_is_noticed(wrong: Any, words: str) -> None:
    assert re.search(words, complaints(priors.CHECKS, wrong))


@dataclass(frozen=True)
class Signed:
    """A mean difference, which may be negative, as if it were a squared distance."""

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        return float((observed.points - simulated.points).mean())


@dataclass(frozen=True)
class Meddling:
    """Moves the interface that it is given."""

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        value = float(((simulated.points - observed.points) ** 2).sum())
        simulated.points[0] += 0.0 if value == 0.0 else 1e-3
        return value


@pytest.mark.parametrize(("wrong", "words"), [(Signed(), "d² is -"), (Meddling(), "second call|changes the simulated")])
def test_a_wrong_discrepancy_is_noticed(wrong: Any, words: str) -> None:
    assert re.search(words, complaints(discrepancies.CHECKS, wrong))
