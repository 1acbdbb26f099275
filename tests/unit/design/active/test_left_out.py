"""Which runs lie inside a posterior, and how far the likelihoods predicted from the others are off there."""

from dataclasses import dataclass, fields, replace

import numpy as np
from tests.unit.calibration import arches
from tests.unit.design.active.fakes import SPACE, Assumed, known, record, state_of

from strandline.design import sobol
from strandline.design.active.left_out import left_out_ratios
from strandline.design.active.state import State
from strandline.discrepancy import NormalOffset
from strandline.interface import Observation, PointErrors

X = np.concatenate([SPACE.to_physical(sobol(24, 2)), [[0.2, 0.1], [0.4, 0.0]]])


@dataclass(frozen=True, eq=False)
class Doubted(Assumed):
    """Knowledge whose uncertainty adds to the likelihood."""

    def expected(self, x: np.ndarray, *, plug_in: np.ndarray | None = None) -> np.ndarray:
        return self.plug_in(x) + 1.8


def state() -> State:
    one = state_of(known(X))
    own = {each.name: getattr(one.knowledge, each.name) for each in fields(one.knowledge)}
    return replace(one, knowledge=Doubted(**own), log_expected=one.log_expected + 1.8)


def test_runs_inside_are_those_of_the_expected_likelihood_and_ratios_are_of_the_true_one() -> None:
    one, records = state(), [record(row) for row in X]
    x, ratios, variances = left_out_ratios(one, records, lambda run: 0.0, SPACE.log_prior)
    within = ((X - np.array([0.2, 0.1])) ** 2).sum(axis=1) < 2 * 0.2**2 * -np.log(0.05)  # 95 % of a normal posterior
    assert within.sum() >= 2
    np.testing.assert_array_equal(x, X[within])
    assert len(ratios) == len(variances) == within.sum()
    _, lower, _ = left_out_ratios(one, records, lambda run: -0.3, SPACE.log_prior)
    np.testing.assert_allclose(lower, ratios - 0.3)


def test_a_posterior_without_any_run_inside_has_no_ratios() -> None:
    """As in a narrow posterior that the first runs have missed: positions where the likelihood is far above theirs."""
    likely = arches.knowledge(NormalOffset(), {"": Observation(arches.seen(PointErrors(1e-5)), PointErrors(1e-5))})
    records = [replace(record(row), interfaces={"": arches.arch(row)}) for row in likely.x]
    positions = arches.TRUTH + 1e-5 * np.random.default_rng(0).standard_normal((50, 2))
    even = np.full(50, -np.log(50.0))
    one = State(likely, positions, even, even, even, np.zeros(50), np.zeros(50))
    x, ratios, variances = left_out_ratios(one, records, lambda run: 0.0, arches.SPACE.log_prior)
    assert x.shape == (0, 2)
    assert len(ratios) == len(variances) == 0
