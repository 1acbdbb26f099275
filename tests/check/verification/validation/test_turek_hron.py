"""Turek and Hron's benchmarks, at rest and through time, on small meshes; whole families are in the modules' `main`."""

import numpy as np
import pytest
from verification.validation.turek_hron import BENCHMARKS, family, solve
from verification.validation.turek_hron_time import CASES, Cylinder, Stage, oscillation, rows, simulate

from strandline.models.biofilm.rates import Moment


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


def test_flow_starts_and_moves_to_a_finer_mesh(tmp_path):
    """The force of the flow on the finer mesh goes on where it was on the coarser one."""
    log = tmp_path / "series.txt"
    first, second = simulate(CASES["CFD3"], [Stage(0, 0.02, 0.2), Stage(1, 0.02, 0.22)], log=log)
    assert len(log.read_text().splitlines()) == 11
    assert first.rows[-1][0] > 10
    before, last = (row[0] for row in first.rows[-2:])
    np.testing.assert_allclose(second.rows[-1][0], 2 * last - before, rtol=0.05)


def test_moved_state_is_the_same_field():
    coarse, fine = (Cylinder(CASES["FSI3"], level) for level in (0, 1))
    values = np.zeros(coarse.system.space.ndof)
    values[coarse.system.free] = np.random.default_rng(0).uniform(-1e-3, 1e-3, len(coarse.system.free))
    moved = fine.moved_from(coarse, Moment(1.0, values, values))
    for state, cylinder in ((values, coarse), (moved.values, fine)):
        cylinder.system.values[:] = state
    for component in (0, 1, 2):
        for place in [(1.1, 0.3), (0.9, 0.1) if component < 2 else (0.5, 0.2)]:
            there, here = (c.system.state.components[component](c.mesh(*place)) for c in (coarse, fine))
            np.testing.assert_allclose(here, there, atol=1e-9)


def test_oscillation_of_a_sine_of_unequal_peaks_and_of_none():
    t = np.arange(0.0, 3.0, 0.001)
    found = oscillation(t.tolist(), (2 + 3 * np.sin(2 * np.pi * 4 * t)).tolist(), window=0.8)
    np.testing.assert_allclose([found.mean, found.amplitude, found.frequency], [2, 3, 4], rtol=1e-4)
    t = np.arange(0.0, 2.75, 0.001)  # the lower peak is the last one
    y = (np.cos(4 * np.pi * t) + 0.1 * np.cos(2 * np.pi * t)).tolist()
    whole, one_peak = (oscillation(t.tolist(), y, window=2.6, period=period) for period in (1.0, None))
    np.testing.assert_allclose(whole.amplitude, 0.5 * (1.1 - (-1.0 - 0.1**2 / 8)), rtol=1e-3)
    assert one_peak.amplitude < 0.99 * whole.amplitude
    none = oscillation([0.0, 0.1, 0.2], [1.0, 2.0, 3.0], window=1.0)
    assert np.isnan(none.frequency)
    assert (none.mean, none.amplitude) == (2.0, 1.0)
