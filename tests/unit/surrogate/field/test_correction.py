"""The correction of a cheaper model's interfaces."""

import numpy as np
import pytest

from strandline.foundations import NoCommonPoints
from strandline.interface import Interface
from strandline.surrogate.field.correction import fit_correction

X = np.linspace(0.0, 1.0, 21)
FINE = np.linspace(0.0, 1.0, 41)


def bend(a, b, *, x=X, lacks=0.0):
    """Return a strip bent by two shapes; it lacks a share of the first one, and a shift."""
    y = a * (1 + lacks) * x**2 + b * np.sin(np.pi * x) + 0.3 * lacks
    return {"": Interface.polyline(np.stack([x, y], axis=1))}


def pairs(number, x=X):
    some = np.random.default_rng(1).uniform(0.1, 0.5, (number, 2))
    return [bend(*one, x=x) for one in some], [bend(*one, lacks=0.1) for one in some]


@pytest.mark.parametrize(("number", "left"), [(3, 0.12), (5, 0.02)])
def test_few_pairs_teach_a_correction_that_is_linear_in_the_interface(number, left):
    correction = fit_correction(*pairs(number))
    for a, b in ((0.2, 0.45), (0.6, 0.05)):  # the second outside of the pairs
        found, right = correction.corrected(bend(a, b)), bend(a, b, lacks=0.1)
        assert correction.distance(found, right) < left * correction.distance(bend(a, b), right)


def test_derivatives_follow_the_interfaces():
    correction, step = fit_correction(*pairs(4)), 1e-6
    ahead, back = (correction.corrected(bend(0.3 + h, 0.2))[""].points for h in (step, -step))
    slope = {"": np.stack([np.zeros(21), X**2], axis=1)}
    found = correction.corrected_slopes(slope)[""]
    np.testing.assert_allclose(found, (ahead - back) / (2 * step), atol=1e-8)
    assert np.abs(found - slope[""]).max() > 0.05
    assert correction.node_by_node


def test_errors_of_left_out_pairs_are_those_of_learning_without_them():
    random, (cheaper, _) = np.random.default_rng(3), pairs(6)
    model = [bend(*random.uniform(0.1, 0.5, 2), lacks=0.1) for _ in cheaper]  # nothing to learn
    whole = fit_correction(cheaper, model)
    for k in range(6):
        without = fit_correction([*cheaper[:k], *cheaper[k + 1 :]], [*model[:k], *model[k + 1 :]])
        error = without.distance(without.corrected(cheaper[k]), model[k])
        assert error == pytest.approx(whole.left_out[k], rel=0.5)  # the scale and the noise share are chosen anew
    assert whole.error == pytest.approx(np.sqrt(np.mean(whole.left_out**2)))
    assert whole.error > 0.5 * whole.spread
    right = fit_correction(*pairs(5))
    assert right.error < 0.02 * right.spread


def test_other_meshes_are_brought_to_the_nodes_of_the_model():
    correction = fit_correction(*pairs(5, FINE))
    assert not correction.node_by_node
    found, right = correction.corrected(bend(0.2, 0.3, x=FINE)), bend(0.2, 0.3, lacks=0.1)
    assert len(found[""].points) == 21
    assert correction.distance(found, right) < 2e-3
    assert correction.distance(bend(0.2, 0.3), right) > 2e-2


def test_distances_are_root_mean_squares_along_the_interface_and_other_conditions_are_refused():
    cheaper, model = pairs(3)
    up = {"": Interface.polyline(bend(0.2, 0.2)[""].points + np.array([0.0, 0.01]))}
    assert fit_correction(cheaper, model).distance(up, bend(0.2, 0.2)) == pytest.approx(0.01)
    with pytest.raises(NoCommonPoints, match="other conditions"):
        fit_correction([{"slow": run[""]} for run in cheaper], model)
