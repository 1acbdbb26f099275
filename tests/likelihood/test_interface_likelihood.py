"""The likelihood adds conditions and reports the constant it leaves out."""

import math

import numpy as np
import pytest
from scipy import stats

from strandline.discrepancy import ClosestPoint, Currents, MeasurementLines, NormalOffset, TrackedPoints
from strandline.errors import InvalidInput, NumericsError
from strandline.interface import Interface, Observation, UnknownErrors
from strandline.likelihood import InterfaceLikelihood


def level(y: float) -> Interface:
    return Interface.polyline(np.array([[0.0, y], [0.5, y], [1.0, y]]))


def test_one_condition():
    likelihood = InterfaceLikelihood((Observation(level(0.0), 0.01),), TrackedPoints())
    assert likelihood(level(0.2)) == pytest.approx(-0.5 * 3 * 0.2**2 / 0.01)
    assert likelihood({"": level(0.2)}) == likelihood(level(0.2))
    assert likelihood.discrepancies(level(0.2)) == pytest.approx([3 * 0.2**2])
    assert likelihood.unit == "mm²"


def test_conditions_add_each_with_its_own_variance():
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


def test_it_is_the_product_of_the_likelihoods_of_the_conditions():
    rng = np.random.default_rng(3)
    names = ("slow", "fast", "still")
    variances = {"slow": 0.1, "fast": 0.2, "still": 0.4}
    observations = tuple(Observation(level(rng.normal()), variances[name], name) for name in names)
    simulated = {name: level(y) for name, y in zip(names, rng.normal(size=3), strict=True)}
    for measure in (TrackedPoints(), ClosestPoint(), Currents(0.1), MeasurementLines(4, reach=9.0)):
        alone = [InterfaceLikelihood((o,), measure)(simulated) for o in observations]
        assert InterfaceLikelihood(observations, measure)(simulated) == pytest.approx(sum(alone))


def test_with_its_constant_it_is_the_gaussian_density_of_tracked_points():
    rng = np.random.default_rng(0)
    observed = [rng.normal(size=(5, 2)), rng.normal(size=(4, 2))]
    simulated = [p + 0.1 * rng.normal(size=p.shape) for p in observed]
    variances = (0.02, 0.05)
    observations = tuple(
        Observation(Interface.polyline(p), v, name) for p, v, name in zip(observed, variances, "ab", strict=True)
    )
    likelihood = InterfaceLikelihood(observations, TrackedPoints())
    exact = sum(
        stats.norm.logpdf(o, s, math.sqrt(v)).sum() for o, s, v in zip(observed, simulated, variances, strict=True)
    )
    assert likelihood.constant is not None
    interfaces = {name: Interface.polyline(p) for name, p in zip("ab", simulated, strict=True)}
    assert likelihood(interfaces) + likelihood.constant == pytest.approx(exact)


def test_constant_counts_measurement_lines_and_is_none_where_there_is_no_count():
    observation = (Observation(level(0.0), 0.01),)
    lines = InterfaceLikelihood(observation, MeasurementLines(4))
    assert lines.constant == pytest.approx(-0.5 * 4 * math.log(2 * math.pi * 0.01))
    for measure in (Currents(0.1), ClosestPoint(), lambda simulated, observed: 0.0):
        assert InterfaceLikelihood(observation, measure).constant is None
        assert InterfaceLikelihood(observation, measure).independent_terms is None


def test_noise_that_is_inferred_leaves_out_a_constant_for_each_point():
    seen = tuple(Observation(level(y), UnknownErrors(), name) for y, name in ((0.0, "slow"), (1.0, "fast")))
    found = InterfaceLikelihood(seen, NormalOffset()).constant
    assert found == pytest.approx(6 * stats.norm.logpdf(0.0))


def test_a_plain_function_is_a_discrepancy():
    likelihood = InterfaceLikelihood((Observation(level(0.0), 2.0),), lambda simulated, observed: 8.0)
    assert likelihood(level(1.0)) == -2.0
    assert likelihood.unit == ""


def test_the_simulated_interface_comes_first():
    seen = []

    def measure(simulated: Interface, observed: Interface) -> float:
        seen.append((simulated.points[0, 1], observed.points[0, 1]))
        return 0.0

    InterfaceLikelihood((Observation(level(3.0), 1.0),), measure)(level(4.0))
    assert seen == [(4.0, 3.0)]


def test_an_observed_condition_that_was_not_simulated_is_refused_by_name():
    both = (Observation(level(0.0), 1.0, "slow"), Observation(level(1.0), 1.0, "fast"))
    likelihood = InterfaceLikelihood(both, TrackedPoints())
    with pytest.raises(InvalidInput, match=r"lack condition 'fast'.*got condition 'slow'; expected at least"):
        likelihood({"slow": level(0.0)})
    with pytest.raises(InvalidInput, match="lack condition 'slow', condition 'fast'"):
        likelihood(level(0.0))
    with pytest.raises(InvalidInput, match="lack a condition without a name"):
        InterfaceLikelihood((Observation(level(0.0), 1.0),), TrackedPoints())({"slow": level(0.0)})


def test_two_observations_of_one_condition_are_refused():
    with pytest.raises(InvalidInput, match="2 observations of a condition without a name"):
        InterfaceLikelihood((Observation(level(0.0), 1.0), Observation(level(1.0), 1.0)), TrackedPoints())


def test_no_observation_is_refused():
    with pytest.raises(InvalidInput, match="observations"):
        InterfaceLikelihood((), TrackedPoints())


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_a_measure_that_returns_no_squared_distance_is_told(value):
    likelihood = InterfaceLikelihood((Observation(level(0.0), 1.0, "day 3"),), lambda simulated, observed: value)
    with pytest.raises(NumericsError, match="day 3"):
        likelihood(level(0.0))


@pytest.mark.parametrize(
    ("measure", "said"),
    [
        (lambda simulated, observed: None, "TypeError: float.*NoneType.*"),
        (lambda simulated, observed: simulated.points, "got a ndarray"),
        (lambda simulated, observed: {}["area"], "KeyError: 'area'"),
    ],
    ids=["nothing", "array", "mistake"],
)
def test_a_measure_that_returns_no_number_is_refused(measure, said):
    likelihood = InterfaceLikelihood((Observation(level(0.0), 0.01),), measure)
    with pytest.raises(InvalidInput, match=f"discrepancy <function .*(?:{said}); expected d², one number"):
        likelihood(level(0.1))
