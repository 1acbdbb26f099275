"""Closed outlines that begin anywhere, in either direction, make the field that they make with fixed nodes."""

import numpy as np
import pytest

from strandline.interface import Interface
from strandline.surrogate.field import FieldTraining, fit_field
from strandline.surrogate.field.correspondence import common_layout, fields_of

NODES = 60
X = np.random.default_rng(3).uniform(size=(40, 2))
LOW, HIGH = np.array([0.5, 0.5]), np.array([2.0, 1.5])


def oval(x, *, nodes=NODES, begin=0.0, first=0, back=False):
    """Return an ellipse with half axes of x₁ and x₁x₂ mm, and its derivatives."""
    (r, f), t = LOW + x * (HIGH - LOW), begin + 2 * np.pi * np.arange(nodes) / nodes
    c, s = np.cos(t), np.sin(t)
    points = np.stack([r * c, f * r * s], axis=1)
    slopes = np.stack([np.stack([c, f * s], axis=1), np.stack([0 * c, r * s], axis=1)], axis=2)
    order = np.roll(np.arange(nodes)[:: -1 if back else 1], -first)
    return Interface.polyline(points[order], closed=True), slopes[order]


def wandering(number, seed=5):
    random = np.random.default_rng(seed)
    return [{"first": int(random.integers(NODES)), "back": bool(random.integers(2))} for _ in range(number)]


@pytest.mark.parametrize("changed", [range(len(X)), [7]], ids=["all", "one"])
def test_the_first_node_and_the_direction_may_differ_in_any_run(changed):
    """If only one run begins one node later, this is noticed, too."""
    how = wandering(len(X)) if len(changed) > 1 else [{"first": int(i in changed)} for i in range(len(X))]
    fixed, runs = [oval(x)[0] for x in X], [oval(x, **one)[0] for x, one in zip(X, how, strict=True)]
    layout = common_layout(runs, X)
    assert (layout.way, common_layout(fixed, X).way) == ("shifted nodes", "nodes")
    fields = fields_of([{"": run} for run in runs], {"": layout})[0].reshape(len(X), NODES, 2)
    first = int(np.argmin(np.linalg.norm(fixed[0].points - fields[0, 0], axis=1)))
    step = 1 if np.allclose(fields[0, 1], fixed[0].points[(first + 1) % NODES]) else -1
    order = (first + step * np.arange(NODES)) % NODES
    np.testing.assert_array_equal(fields, [run.points[order] for run in fixed])


def test_derivatives_are_shifted_with_the_nodes():
    how = wandering(12)
    given = [oval(x, **one) for x, one in zip(X, how, strict=False)]
    runs, slopes = [{"": run} for run, _ in given], [{"": slope} for _, slope in given]
    inputs = LOW + X[:12] * (HIGH - LOW)
    found = fit_field(FieldTraining(inputs, runs, slopes, LOW, HIGH))
    assert found.gradients
    assert found.ways == ("shifted nodes",)
    middle = found.interfaces(np.array([1.2, 0.9]))[""].points
    np.testing.assert_allclose((middle[:, 0] / 1.2) ** 2 + (middle[:, 1] / 1.08) ** 2, 1.0, atol=2e-3)


def test_nodes_that_slide_along_the_outline_with_the_inputs_stay_paired_by_number():
    """They slide by up to eight distances of neighbours."""
    runs = [oval(x, begin=0.8 * x[1])[0] for x in X]
    assert common_layout(runs, X).way == "nodes"


def test_outlines_of_other_numbers_of_nodes_begin_where_they_lie_closest_to_the_mean():
    """The field is as smooth in the inputs as with fixed nodes, but for the chords."""
    random = np.random.default_rng(8)
    numbers, begins = random.integers(90, 130, len(X)), random.uniform(0, 2 * np.pi, len(X))
    runs = [{"": oval(x, nodes=int(n), begin=b)[0]} for x, n, b in zip(X, numbers, begins, strict=True)]
    fixed = [{"": oval(x, nodes=120)[0]} for x in X]
    x = LOW + X * (HIGH - LOW)
    errors = [
        np.sqrt(np.mean(fit_field(FieldTraining(x, one, None, LOW, HIGH)).left_out_error() ** 2))
        for one in (runs, fixed)
    ]
    assert errors[0] < errors[1] + 1e-3
    assert common_layout([run[""] for run in runs], X).way == "arclength"
    same = [oval(x, begin=b)[0] for x, b in zip(X, begins, strict=True)]
    assert common_layout(same, X).way == "arclength"  # as many nodes in all runs, but no common ones
