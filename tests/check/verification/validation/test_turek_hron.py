"""Turek and Hron's benchmarks, at rest and through time, on small meshes; whole families are in the modules' `main`."""

import numpy as np
import pytest
from verification.validation.turek_hron import BENCHMARKS, family, solve
from verification.validation.turek_hron_time import CASES, Stage, rows, simulate


@pytest.mark.parametrize(
    ("name", "level", "order", "allowed"),
    [("CSM2", 1, 2, {"ux": 3e-3, "uy": 3e-3}), ("FSI1", 0, 3, {"ux": 5e-3, "uy": 1e-2, "drag": 5e-4, "lift": 5e-3})],
)
def test_published_values(name, level, order, allowed):
    benchmark = BENCHMARKS[name]
    values = solve(benchmark, level, order=order).values
    assert set(values) == set(allowed) == set(benchmark.reference)
    off = {key: abs(values[key] / reference - 1) for key, reference in benchmark.reference.items()}
    assert all(off[key] < allowed[key] for key in allowed), off


def test_beam_converges_at_the_order_its_corners_admit():
    values = [outcome.values["uy"] for outcome in family(BENCHMARKS["CSM2"], order=2, levels=3)]
    assert 2**2.0 < (values[1] - values[0]) / (values[2] - values[1]) < 2**3.2


def test_beam_under_its_weight_swings_as_published():
    case, stage = CASES["CSM3"], Stage(0, 0.01, 2.0)
    (run,) = simulate(case, [stage])
    for name, *_, mean, amplitude, frequency in rows(case, stage, run):
        off = np.abs(np.array([mean, amplitude, frequency]) / case.reference[name] - 1)
        assert (off < [0.04, 0.04, 0.01]).all()


def test_flow_starts_and_moves_to_a_finer_mesh():
    """The force of the flow on the finer mesh goes on where it was on the coarser one."""
    first, second = simulate(CASES["CFD3"], [Stage(0, 0.02, 0.2), Stage(1, 0.02, 0.22)])
    assert (len(first.rows), len(second.rows)) == (10, 1)
    assert first.rows[-1][0] > 10
    before, last = (row[0] for row in first.rows[-2:])
    np.testing.assert_allclose(second.rows[-1][0], 2 * last - before, rtol=0.05)
