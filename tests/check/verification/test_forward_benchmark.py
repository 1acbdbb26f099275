"""The benchmark of the forward model, on few points of the coarse mesh."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from verification.benchmarks import forward

from strandline.interface import Interface
from strandline.models.biofilm.geometry import MESHES
from strandline.models.biofilm.model import Biofilm
from strandline.runs import InProcess, RunRecord, RunRequest

ROOT = Path(__file__).parents[3]
PEAK = """
from verification.benchmarks.forward import peak_memory
before = peak_memory()
block = bytearray(b"1") * (int(before + 64) * 2**20)
del block
print(before, peak_memory())
"""


def test_a_profile_has_the_share_of_each_part_and_counts_each_jacobian_once():
    before = [getattr(owner, name) for owner, name in forward.PARTS.values()]
    cell = forward.flow_cell(MESHES["coarse"])
    found = forward.profile(cell, [(400.0, 0.3), (700.0, -0.2)])
    assert found.failures == 0
    assert found.calls["factorisation"] == found.calls["assembly"] == found.jacobians
    balances = 2  # a run checks that of its solution, with no equation to solve
    assert found.calls["back-substitution"] == found.calls["residuals"] - balances > found.jacobians
    assert set(found.shares) == {"assembly", "factorisation", "residuals", "back-substitution", "rest"}
    assert all(0 < share < 1 for share in found.shares.values())
    np.testing.assert_allclose(sum(found.shares.values()), 1.0)
    failed = forward.profile(cell, [(100.0, 0.4)])
    assert failed.failures == 1
    assert 0 < failed.failed <= failed.total
    assert [getattr(owner, name) for owner, name in forward.PARTS.values()] == before


def test_clock_gives_each_part_its_own_time():
    now = [0.0]
    clock = forward.Clock(now=lambda: now[0])

    def pass_by(seconds):
        now[0] += seconds

    inner = clock.measured("inner", pass_by)
    clock.measured("outer", lambda: (pass_by(1.0), inner(5.0), inner(5.0)))()
    assert clock.seconds == {"outer": 1.0, "inner": 10.0}
    assert clock.calls == {"outer": 1, "inner": 2}


def test_runs_from_anchors_are_measured_beside_those_without():
    cold = forward.pace(Biofilm(mesh="coarse"), forward.design(4))
    assert sorted(int(record.key) for record in cold.records) == list(range(4))
    assert {record.failure_kind for record in cold.records} <= {None, "limit_point", "continuation_stalled"}
    assert cold.start_up == cold.times[0] > 0
    found = {one.what: one.value for one in forward.anchored_figures("coarse", "coarse", cold, points=4)}
    assert found["solving the anchors, once"] > 0.1  # in a process that has none yet
    assert found["runs without a Jacobian"] >= 2
    assert 0.0 < found["largest difference to a run without"] < 1e-4


def test_figures_of_records_and_costs():
    assert forward.Pace([], [10.0, 11.0, 13.0, 16.0]).per_minute == pytest.approx(30.0)
    E, nu = np.array(forward.design(256)).T
    assert (E.min(), nu.min()) == (100.0, -0.8)
    np.testing.assert_allclose([E.mean(), nu.mean()], [450.0, -0.15], atol=2.0)
    ends = [("ok", 90.0), ("failed", 80.0), ("ok", 1.0), ("ok", 2.0), ("ok", 3.0), ("failed", 5.0), ("timeout", 8.0)]
    records = [RunRecord(str(k), {}, state, seconds=seconds) for k, (state, seconds) in enumerate(ends)]
    assert forward.failure_costs(records) == [2.5, 4.0]  # in successful runs, without each worker's first
    costs = [forward.Cost(n, n, 1e-4 * n**1.3) for n in (1000, 4000, 9000)]
    assert forward.exponent(costs) == pytest.approx(1.3)


def test_peak_memory_is_that_of_a_process_alone_and_counts_what_was_freed():
    done = subprocess.run([sys.executable, "-c", PEAK], cwd=ROOT, capture_output=True, text=True, check=True)
    before, after = map(float, done.stdout.split())
    assert after >= before + 64
    block = np.ones(600 * 2**17)
    (record,) = forward.pace(forward.PeakMemory(Biofilm(mesh="coarse")), [(400.0, 0.3)]).records
    assert block.nbytes / 2**20 == 600
    assert 50 < record.diagnostics["peak_MiB"] < 600


def test_campaigns_that_end_otherwise_are_infinitely_far_apart():
    requests = [RunRequest(str(k), {"E": E, "nu": 0.3, "V_in": 100.0}) for k, E in enumerate((400.0, 60.0))]
    records = list(InProcess()(Biofilm(mesh="coarse"), requests))
    moved = replace(records[0], interfaces={"": Interface.polyline(records[0].interface.points + 1e-3)})
    swapped = [replace(one, key=records[1 - k].key) for k, one in enumerate(records)]
    assert [record.ok for record in records] == [True, False]
    assert forward.difference(records, [records[1], moved]) == pytest.approx(1e-3)
    assert forward.difference(records, swapped) == np.inf
