"""The pieces of the benchmark of the forward model, on few points of the coarse mesh."""

import json

import numpy as np
import pytest
from benchmarks import forward
from benchmarks.__main__ import save

from strandline.models.biofilm.cell import FlowCell
from strandline.models.biofilm.geometry import MESHES, mesh_flow_cell
from strandline.models.biofilm.linear import linear_solver
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import Outline
from strandline.runs import RunRecord

COARSE = MESHES["coarse"]


@pytest.fixture(scope="module")
def cell() -> FlowCell:
    return forward.flow_cell(COARSE)


def test_shares_are_positive_and_add_up_to_one(cell):
    profiled = forward.profile(cell, [(400.0, 0.3), (100.0, 0.4), (700.0, -0.2)])
    shares = profiled.shares
    assert set(shares) == {"assembly", "factorisation", "residuals", "back-substitution", "rest"}
    assert all(0 < share < 1 for share in shares.values())
    np.testing.assert_allclose(sum(shares.values()), 1.0)
    assert profiled.failures == 1
    assert 0 < profiled.failed < profiled.total


def test_each_jacobian_is_counted_once(cell):
    found = forward.profile(cell, [(400.0, 0.3), (700.0, -0.2)])
    assert found.failures == 0
    assert found.calls["factorisation"] == found.calls["assembly"] == found.jacobians
    balances = 2  # a run checks that of its solution, with no equation to solve
    assert found.calls["back-substitution"] == found.calls["residuals"] - balances > found.jacobians


def test_methods_are_timed_during_a_profile_only(cell):
    before = [getattr(owner, name) for owner, name in forward.PARTS.values()]
    forward.profile(cell, [])
    assert [getattr(owner, name) for owner, name in forward.PARTS.values()] == before


def test_clock_gives_each_part_its_own_time(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(forward.time, "perf_counter", lambda: now[0])
    clock = forward.Clock()

    def passing(seconds: float) -> None:
        now[0] += seconds

    inner = clock.measured("inner", lambda: passing(5.0))

    def both() -> None:
        passing(1.0)
        inner()
        inner()

    clock.measured("outer", both)()
    assert clock.seconds == {"outer": 1.0, "inner": 10.0}
    assert clock.calls == {"outer": 1, "inner": 2}


def test_pace_answers_each_point_and_leaves_the_start_out():
    points = forward.design(4)
    measured = forward.pace(Biofilm(mesh="coarse"), points)
    assert sorted(int(record.key) for record in measured.records) == list(range(4))
    assert {record.failure_kind for record in measured.records} <= {None, "limit_point", "continuation_stalled"}
    assert measured.start_up == measured.times[0] > 0
    assert forward.Pace([], [10.0, 11.0, 13.0, 16.0]).per_minute == pytest.approx(30.0)


def test_design_lies_in_the_box_of_the_study():
    E, nu = np.array(forward.design(256)).T
    assert (E.min(), nu.min()) == (100.0, -0.8)
    np.testing.assert_allclose([E.mean(), nu.mean()], [450.0, -0.15], atol=2.0)


def test_failures_are_measured_in_successful_runs_without_each_workers_first():
    ends = [("ok", 90.0), ("failed", 80.0), ("ok", 1.0), ("ok", 2.0), ("ok", 3.0), ("failed", 5.0), ("timeout", 8.0)]
    records = [RunRecord(str(k), {}, state, seconds=seconds) for k, (state, seconds) in enumerate(ends)]
    assert forward.failure_costs(records) == [2.5, 4.0]


def test_cost_grows_with_unknowns():
    small, large = (forward.solve_cost(MESHES[name], repeats=1) for name in ("coarse", "default"))
    assert (small.elements, large.elements) == (488, 1194)
    assert large.unknowns > 1.5 * small.unknowns
    assert large.seconds > small.seconds


def test_scaled_mesh_has_about_as_many_more_elements():
    fine, finer = (mesh_flow_cell(Outline().interface(), forward.scaled(MESHES["fine"], f)).ne for f in (1.0, 0.7))
    np.testing.assert_allclose(finer / fine, 0.7**-2, rtol=0.2)


def test_exponent_of_a_power_law():
    costs = [forward.Cost(n, n, 1e-4 * n**1.3) for n in (1000, 4000, 9000)]
    assert forward.exponent(costs) == pytest.approx(1.3)


def test_sensitivities_cost_about_as_much_as_a_run_or_less():
    (ratio,) = forward.sensitivity_ratios("coarse", [(400.0, 0.3)], repeats=2)
    assert 0.6 < ratio < 2.5


def test_peak_memory_counts_what_was_allocated_and_freed():
    before = forward.peak_memory()
    block = np.ones(int(before + 64) * 2**17)
    del block
    assert forward.peak_memory() >= before + 64


def test_peak_memory_of_a_worker_is_not_that_of_its_driver():
    block = np.ones(600 * 2**17)
    (record,) = forward.pace(forward.PeakMemory(Biofilm(mesh="coarse")), [(400.0, 0.3)]).records
    assert block.nbytes / 2**20 == 600
    assert 50 < record.diagnostics["peak_MiB"] < 600


def test_a_solver_that_is_not_there_is_said_to_be_not_installed(monkeypatch):
    monkeypatch.setattr("strandline.models.biofilm.linear._pardiso_works", lambda: False)
    with forward.using("umfpack") as installed:
        assert installed
        assert linear_solver() == "umfpack"
    with forward.using("pardiso") as installed:
        assert not installed
        (row,) = forward.pace_figures("coarse", "pardiso", installed=installed)
    assert (row.value, row.remark) == (None, "not installed")


def test_figures_of_one_part_leave_those_of_the_other(tmp_path):
    output = tmp_path / "output" / "results.json"
    save(output, "inference", [{"what": "a"}])
    save(output, "forward", [{"what": "b"}])
    save(output, "inference", [{"what": "c"}])
    assert json.loads(output.read_text()) == {"inference": [{"what": "c"}], "forward": [{"what": "b"}]}
