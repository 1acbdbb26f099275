"""Turek and Hron's benchmarks through time on small meshes; the whole runs are in the module's own `main`."""

import numpy as np
from verification.validation.turek_hron_time import CASES, Cylinder, Stage, oscillation, rows, simulate

from strandline.models.biofilm.rates import Moment


def test_beam_under_its_weight_swings_as_published():
    case, stage = CASES["CSM3"], Stage(0, 0.01, 2.0)
    (run,) = simulate(case, [stage])
    for row in rows(case, stage, run):
        name, mean, amplitude, frequency = row[0], *row[-3:]
        published = case.reference[name]
        assert abs(mean / published[0] - 1) < 0.04
        assert abs(amplitude / published[1] - 1) < 0.04
        assert abs(frequency / published[2] - 1) < 0.01


def test_flow_starts_and_moves_to_a_finer_mesh(tmp_path):
    """The force of the flow on the finer mesh goes on where it was on the coarser one."""
    stages = [Stage(0, 0.02, 0.2), Stage(1, 0.02, 0.22)]
    log = tmp_path / "series.txt"
    first, second = simulate(CASES["CFD3"], stages, log=log)
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
    highest, lowest = 1.1, -1.0 - 0.1**2 / 8
    np.testing.assert_allclose(whole.amplitude, 0.5 * (highest - lowest), rtol=1e-3)
    assert one_peak.amplitude < 0.99 * whole.amplitude
    none = oscillation([0.0, 0.1, 0.2], [1.0, 2.0, 3.0], window=1.0)
    assert np.isnan(none.frequency)
    assert (none.mean, none.amplitude) == (2.0, 1.0)
