"""A batch of interfaces against the measure of a single one."""

import numpy as np
import pytest
from verification.reproduction.batch import batch_currents, batch_log_likelihood

from strandline.discrepancy import Currents
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models.biofilm.outline import Outline
from verification.reproduction import batch


def bent(amplitudes):
    """The outline of the biofilm, sheared with a wave: the segments slide, turn and change their lengths."""
    points = Outline().interface().points
    x, y = points.T
    move = np.stack([y / 0.47 + 0.1 * np.sin(9 * x), -0.3 * x * y], axis=1)
    return points + np.asarray(amplitudes)[:, None, None] * move


@pytest.mark.parametrize("quadrature", ["centre", "refined"])
@pytest.mark.parametrize("width", [0.002, 0.005, 0.05])
def test_batch_is_the_measure_one_by_one(quadrature, width):
    """At 0.002 mm the segments are longer than a piece of the Gauss rule and are divided."""
    measure = Currents(width, quadrature=quadrature, tolerance=1e-8)
    shapes = bent(np.linspace(0.0, 0.09, 7))
    observed = Interface.polyline(bent([0.05])[0])
    singly = np.array([measure(Interface.polyline(points), observed) for points in shapes])
    np.testing.assert_allclose(
        batch_currents(measure, shapes, observed), singly, atol=1e-9 * measure.inner(observed, observed) + 1e-12
    )


@pytest.mark.parametrize("quadrature", ["centre", "refined"])
def test_blocks_change_nothing(quadrature, monkeypatch):
    measure = Currents(0.005, quadrature=quadrature)
    shapes, observed = bent(np.linspace(0.0, 0.09, 9)), Interface.polyline(bent([0.05])[0])
    whole = batch_currents(measure, shapes, observed)
    monkeypatch.setattr(batch, "WORK", 1)
    np.testing.assert_allclose(batch_currents(measure, shapes, observed), whole, atol=1e-12)


@pytest.mark.parametrize("quadrature", ["centre", "refined"])
def test_pairs_left_out_too_early_are_noticed(quadrature, monkeypatch):
    measure = Currents(0.02, quadrature=quadrature)
    shapes, observed = bent([0.0, 0.08]), Interface.polyline(bent([0.05])[0])
    right = batch_currents(measure, shapes, observed)
    monkeypatch.setattr(batch, "NEGLIGIBLE", 0.9)
    assert np.abs(batch_currents(measure, shapes, observed) - right).max() > 1e-4


def test_log_likelihood_of_another_measure_takes_the_interfaces_one_by_one():
    def heights(simulated, observed):
        return float(np.sum((simulated.points - observed.points) ** 2))

    shapes = bent([0.0, 0.02, 0.05])
    observation = Observation(Interface.polyline(shapes[2]), 0.01)
    values = batch_log_likelihood(InterfaceLikelihood((observation,), heights), shapes)
    np.testing.assert_allclose(values, [-50 * np.sum((s - shapes[2]) ** 2) for s in shapes])


def test_log_likelihood_of_currents_has_the_noise():
    shapes = bent([0.0, 0.02])
    observation = Observation(Interface.polyline(bent([0.05])[0]), 0.0005)
    likelihood = InterfaceLikelihood((observation,), Currents(0.005))
    singly = [likelihood(Interface.polyline(points)) for points in shapes]
    np.testing.assert_allclose(batch_log_likelihood(likelihood, shapes), singly, atol=1e-6)
