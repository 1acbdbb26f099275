"""The likelihood adds conditions and reports the constant it leaves out."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from scipy import stats

from strandline.discrepancy import ClosestPoint, Currents, MeasurementLines, NormalOffset, TrackedPoints
from strandline.errors import InvalidInput, NumericsError
from strandline.interface import Interface, Observation, UnknownErrors
from strandline.likelihood import InterfaceLikelihood


def level(y: float) -> Interface:
    return Interface.polyline(np.array([[0.0, y], [0.5, y], [1.0, y]]))


def test_one_condition() -> None:
    likelihood = InterfaceLikelihood((Observation(level(0.0), 0.01),), TrackedPoints())
    assert likelihood(level(0.2)) == pytest.approx(-0.5 * 3 * 0.2**2 / 0.01)
    assert likelihood({"": level(0.2)}) == likelihood(level(0.2))
    assert likelihood.discrepancies(level(0.2)) == pytest.approx([3 * 0.2**2])
    assert likelihood.unit == "mm²"


def test_conditions_add_each_with_its_own_variance() -> None:
    observations = (Observation(level(0.0), 0.01, "slow"), Observation(level(1.0), 0.04, "fast"))
    likelihood = InterfaceLikelihood(observations, TrackedPoints())
    for simulated in (
        {"slow": level(0.1), "fast": level(0.8)},
        {"fast": level(0.8), "unobserved": level(9.0), "slow": level(0.1)},
    ):
        assert likelihood.discrepancies(simulated) == pytest.approx([0.03, 0.12])
        assert likelihood(simulated) == pytest.approx(-0.5 * (0.03 / 0.01 + 0.12 / 0.04))
    assert likelihood.conditions == ("slow", "fast")
    assert likelihood.independent_terms == 12  # two coordinates of three points, twice
    for measure in (ClosestPoint(), Currents(0.1), MeasurementLines(4, reach=9.0)):
        simulated = {"slow": level(0.1), "fast": level(0.8)}
        alone = [InterfaceLikelihood((o,), measure)(simulated) for o in observations]
        assert InterfaceLikelihood(observations, measure)(simulated) == pytest.approx(sum(alone))


def test_with_its_constant_it_is_the_gaussian_density_of_tracked_points() -> None:
    rng = np.random.default_rng(0)
    observed = [rng.normal(size=(5, 2)), rng.normal(size=(4, 2))]
    simulated = [p + 0.1 * rng.normal(size=p.shape) for p in observed]
    given = list(zip("ab", observed, simulated, (0.02, 0.05), strict=True))
    likelihood = InterfaceLikelihood(
        tuple(Observation(Interface.polyline(o), v, name) for name, o, _, v in given), TrackedPoints()
    )
    exact = sum(stats.norm.logpdf(o, s, math.sqrt(v)).sum() for _, o, s, v in given)
    assert likelihood.constant is not None
    interfaces = {name: Interface.polyline(s) for name, _, s, _ in given}
    assert likelihood(interfaces) + likelihood.constant == pytest.approx(exact)


def test_the_constant_counts_lines_or_points_and_is_none_where_there_is_no_count() -> None:
    observation = (Observation(level(0.0), 0.01),)
    lines = InterfaceLikelihood(observation, MeasurementLines(4))
    assert lines.constant == pytest.approx(-0.5 * 4 * math.log(2 * math.pi * 0.01))
    for measure in (Currents(0.1), ClosestPoint(), lambda simulated, observed: 0.0):
        assert InterfaceLikelihood(observation, measure).constant is None
        assert InterfaceLikelihood(observation, measure).independent_terms is None
    seen = tuple(Observation(level(y), UnknownErrors(), name) for y, name in ((0.0, "slow"), (1.0, "fast")))
    assert InterfaceLikelihood(seen, NormalOffset()).constant == pytest.approx(6 * stats.norm.logpdf(0.0))


def test_a_plain_function_is_a_discrepancy_of_the_simulated_and_the_observed_interface() -> None:
    seen = []

    def measure(simulated: Interface, observed: Interface) -> float:
        seen.append((simulated.points[0, 1], observed.points[0, 1]))
        return 8.0

    likelihood = InterfaceLikelihood((Observation(level(3.0), 2.0),), measure)
    assert likelihood(level(4.0)) == -2.0
    assert likelihood.unit == ""
    assert seen == [(4.0, 3.0)]


def test_observations_that_do_not_fit_are_refused() -> None:
    plain, slow, fast = (Observation(level(0.0), 1.0, name) for name in ("", "slow", "fast"))
    rows: list[tuple[tuple[Observation, ...], Interface | Mapping[str, Interface], str]] = [
        ((slow, fast), {"slow": level(0.0)}, r"lack condition 'fast'.*got condition 'slow'; expected at least"),
        ((slow, fast), level(0.0), "lack condition 'slow', condition 'fast'"),
        ((plain,), {"slow": level(0.0)}, "lack a condition without a name"),
        ((plain, plain), level(0.0), "2 observations of a condition without a name"),
        ((), level(0.0), "observations"),
    ]
    for observations, simulated, said in rows:
        with pytest.raises(InvalidInput, match=said):
            InterfaceLikelihood(observations, TrackedPoints())(simulated)


def test_a_measure_that_returns_no_squared_distance_is_told() -> None:
    rows: list[tuple[Callable[..., Any], type[Exception], str]] = [
        (lambda simulated, observed: math.nan, NumericsError, "day 3"),
        (lambda simulated, observed: math.inf, NumericsError, "day 3"),
        (lambda simulated, observed: -1.0, NumericsError, "day 3"),
        (lambda simulated, observed: None, InvalidInput, "TypeError: float.*NoneType.*; expected d², one number"),
        (lambda simulated, observed: simulated.points, InvalidInput, "got a ndarray; expected d², one number"),
        (lambda simulated, observed: {}["area"], InvalidInput, "KeyError: 'area'; expected d², one number"),
    ]
    for measure, error, said in rows:
        with pytest.raises(error, match=said):
            InterfaceLikelihood((Observation(level(0.0), 1.0, "day 3"),), measure)({"day 3": level(0.1)})
