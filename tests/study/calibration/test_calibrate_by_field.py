"""The whole method by a surrogate of the field, also with a cheaper model, on a beam whose posterior is known."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from tests.study.calibration.beams import ACTIVE, NOISE, answer, exact, problem

from strandline.design.active import Active
from strandline.foundations import ForwardModelError
from strandline.interface import Interface
from strandline.models.fidelities import WithCheaper, is_cheaper
from strandline.models.protocol import Simulation
from strandline.testing.studies import beam


def test_the_posterior_is_exact_and_certified(tmp_path):
    """Planted: a noise variance twice as large."""
    found = answer(tmp_path, problem())
    exact().assert_off(found, 0.12, 0.1)
    assert max(exact(noise=NOISE * np.sqrt(2.0)).off(found)[:2]) > 0.2
    assert found.field.certificate.converged
    assert len(found.records) < 60
    assert np.abs(found.field.effect.shift).max() < 0.05


def capricious(inputs, workdir):
    """Return the beam; a fifth of its runs fail by the digits of E."""
    if (inputs["E"] * 7919.0) % 1.0 < 0.2:
        raise ForwardModelError("newton_stalled", "no convergence")
    return beam(inputs, workdir)


def test_runs_that_fail_at_random_are_gone_round(tmp_path):
    found = answer(tmp_path, problem(model=capricious))
    assert 0.05 < np.mean([not record.ok for record in found.records]) < 0.4
    exact().assert_off(found, 0.12, 0.1)
    assert found.field.certificate.converged


@dataclass(frozen=True)
class Beam:
    """The beam, made softer by a share, and shaken by an amount that depends on the inputs without any order."""

    soft: float = 0.0
    shaken: float = 0.0

    @property
    def fingerprint(self):
        return f"beam:{self.soft}:{self.shaken}"

    def __call__(self, inputs, workdir):
        inputs = {name: value for name, value in inputs.items() if name in ("E", "tilt", "load")}
        points = beam({**inputs, "E": inputs["E"] / (1 + self.soft)}, workdir).interface.points.copy()
        seed = np.frombuffer(np.array([inputs["E"], inputs["tilt"]]).tobytes(), np.uint32)
        a, b = np.random.default_rng(seed).standard_normal(2)
        points[:, 1] += self.shaken * (a * np.sin(np.pi * points[:, 0]) + b * np.sin(2 * np.pi * points[:, 0]))
        return Simulation.of(Interface.polyline(points))


def with_cheaper(folder, cheaper, runs):
    asked = problem(model=WithCheaper(Beam(), cheaper, 0.2))
    found = answer(folder, asked, replace(ACTIVE, active=Active(runs, batch=4)))
    return found, found.field.certificate.fidelities


def test_a_good_cheaper_model_makes_most_runs_and_the_posterior_is_the_models(tmp_path):
    """The same ledger gives the same result without a run."""
    (good, report), (again, other) = (with_cheaper(tmp_path, Beam(soft=0.1), 60) for _ in range(2))
    exact().assert_off(good, 0.12, 0.12)
    assert report.dropped is None
    assert report.error < 0.1 * report.hidden
    assert report.model <= 10
    assert report.cheaper >= 15
    assert len(good.all_runs) == report.cheaper + report.model
    assert sum(is_cheaper(record.inputs) for record in good.all_runs) == report.cheaper
    assert not any(is_cheaper(record.inputs) for record in good.records)
    np.testing.assert_array_equal(good.posterior.draws, again.posterior.draws)
    assert report == other


@pytest.mark.parametrize("shaken", [pytest.param(0.0005, marks=pytest.mark.long), 0.03])
def test_a_cheaper_model_that_misleads_is_dropped(shaken, tmp_path):
    """The noise hides a shift of 0.0015; the cheaper model errs by a third and by 20 times that, at random."""
    found, report = with_cheaper(tmp_path, Beam(shaken=shaken), 140)
    assert report.dropped is not None
    assert not any("-" in record.key for record in found.records)  # runs of the model alone
    assert found.field.certificate.converged
    exact().assert_off(found, 0.12, 0.12)
