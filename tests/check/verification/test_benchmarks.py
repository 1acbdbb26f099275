"""The pieces of the benchmark: the forward model on few points of the coarse mesh, aims, results, peers, the page."""

import json
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from verification.benchmarks import __main__ as bench
from verification.benchmarks import forward, page, plots, results, workers
from verification.benchmarks.__main__ import PARTS
from verification.benchmarks.aims import AIMS, LEAST, MOST, PER_CORE, RATIO, Aim, aim_of
from verification.benchmarks.comparison import Comparison, NotMeasured, summarised, unmeasured
from verification.benchmarks.peers import install

from strandline.interface import Interface
from strandline.models.biofilm.cell import FlowCell
from strandline.models.biofilm.geometry import MESHES, mesh_flow_cell
from strandline.models.biofilm.linear import linear_solver
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import Outline
from strandline.runs import InProcess, RunRecord, RunRequest

ROOT = Path(__file__).parents[3]
COARSE = MESHES["coarse"]
PEAK = """
from verification.benchmarks.forward import peak_memory
before = peak_memory()
block = bytearray(b"1") * (int(before + 64) * 2**20)
del block
print(before, peak_memory())
"""


@pytest.mark.parametrize("part", PARTS)
def test_every_part_is_found_by_its_name(part, monkeypatch):
    """In the process that measures it: by the names that the program gives to Python."""
    commands, saved = [], []
    monkeypatch.setattr(subprocess, "run", lambda words: commands.append(words) or SimpleNamespace(returncode=0))
    monkeypatch.setattr(results, "note_run", lambda *args, **kinds: None)
    assert bench.run(part)
    ((_, option, package, *arguments),) = commands
    assert option == "-m"
    assert Path(str(find_spec(f"{package}.__main__").origin)).samefile(bench.__file__)
    monkeypatch.setattr(f"{package}.{part}.main", lambda: [part])
    monkeypatch.setattr(results, "save", lambda name, records, parts: saved.append((name, records)))
    assert bench.main(arguments) == 0
    assert saved == [(part, [part])]


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


def test_cost_is_the_median_of_solves_beside_the_size_of_the_mesh(monkeypatch):
    seconds = iter([3.0, 1.0, 2.0, 8.0, 9.0, 4.0])
    monkeypatch.setattr(forward, "timed", lambda solve, *arguments: next(seconds))
    small, large = (forward.solve_cost(MESHES[name], repeats=3) for name in ("coarse", "default"))
    assert (small.elements, large.elements) == (488, 1194)
    assert large.unknowns > 1.5 * small.unknowns
    assert (small.seconds, large.seconds) == (2.0, 8.0)


def test_scaled_mesh_has_about_as_many_more_elements():
    fine, finer = (mesh_flow_cell(Outline().interface(), forward.scaled(MESHES["fine"], f)).ne for f in (1.0, 0.7))
    np.testing.assert_allclose(finer / fine, 0.7**-2, rtol=0.2)


def test_exponent_of_a_power_law():
    costs = [forward.Cost(n, n, 1e-4 * n**1.3) for n in (1000, 4000, 9000)]
    assert forward.exponent(costs) == pytest.approx(1.3)


def test_the_cost_of_sensitivities_is_that_of_a_run_with_them_over_one_without(monkeypatch):
    seconds = {True: iter([3.0, 30.0, 4.5]), False: iter([2.0, 3.0, 20.0])}
    monkeypatch.setattr(forward, "timed", lambda model, inputs: next(seconds[model.sensitivities]))
    (ratio,) = forward.sensitivity_ratios("coarse", [(400.0, 0.3)])
    assert ratio == pytest.approx(4.5 / 3.0)


def test_peak_memory_counts_what_was_allocated_and_freed():
    """In a process of its own: this one has had a peak of gigabytes, and would have to pass it."""
    done = subprocess.run([sys.executable, "-c", PEAK], cwd=ROOT, capture_output=True, text=True, check=True)
    before, after = map(float, done.stdout.split())
    assert after >= before + 64


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


def comparison(what: str, peer: str, ratio: float | None, **more) -> dict:
    seconds = {"ours": None, "peer": None} if ratio is None else {"ours": 2.0, "peer": 2.0 * ratio}
    return {"what": what, "peer_name": peer, **seconds, "ratio": ratio, "repeats": 3, **more}


def pace_of(case: str, value: float | None) -> dict:
    return {"what": "solves, 2 workers", "case": case, "value": value, "unit": "per minute"}


PRODUCT = "evidence and gradient, matern32_product, n = 2000"


@pytest.mark.parametrize(
    ("part", "found", "bound", "met"),
    [
        ("surrogate", comparison(PRODUCT, "JAX, autodiff of a Cholesky", 5.1), 5, True),
        ("surrogate", comparison(PRODUCT, "GPJax", 4.9), 5, False),
        ("surrogate", comparison(PRODUCT, "scikit-learn", 9.0), 10, False),
        ("surrogate", comparison(PRODUCT, "GPyTorch", 3.0), None, None),
        ("surrogate", comparison(PRODUCT.replace("2000", "20000"), "GPJax", 3.0), None, None),
        ("surrogate", comparison(PRODUCT, "GPJax", None, remark="not measured: no wheel"), 5, None),
        ("surrogate", comparison(PRODUCT.replace("2000", "5000"), "dpotrf + dpotri alone", 0.72), 1 / 1.4, True),
        ("inference", comparison(PRODUCT, "GPJax", 1.0), None, None),
        ("norms", comparison("currents: d², 10082² triangles, width 0.3", "all pairs in NumPy, blocks", 5.0), 5, True),
        ("norms", {"what": "currents: d², 100352² triangles", "value": 1200.0, "unit": "MiB"}, 1000, False),
        ("norms", {"what": "currents: d², 100352² triangles", "value": 4.0, "unit": "s"}, None, None),
        ("norms", comparison("closest points: 6600 to 2000 segments", "all pairs in NumPy, blocks", 14.0), 15, False),
        ("startup", {"what": "strandline --help", "value": 0.1, "unit": "s"}, 0.15, True),
        ("startup", {"what": "strandline status", "case": "plan in the ledger", "value": 0.7, "unit": "s"}, 0.6, False),
        (
            "forward",
            pace_of("coarse, umfpack", 1e3),
            1100,
            False,
        ),
        (
            "forward",
            pace_of("default, umfpack", 420.0),
            400,
            True,
        ),
        (
            "forward",
            pace_of("default, mkl", None),
            400,
            None,
        ),
    ],
)
def test_a_figure_has_its_aim_and_is_judged_by_it(part, found, bound, met):
    record = results.judged(found, part)
    assert list(record)[:6] == ["what", "ours", "peer", "ratio", "aim", "met"]
    assert record["aim"] is bound is None or record["aim"] == pytest.approx(bound, rel=1e-4)
    assert record["met"] is met


def costs(ours: tuple[float, float, int], peer: tuple[float, float, int], ratio: float, per_core: float) -> dict:
    names = ("wall", "cpu", "evaluations")
    pair = {"ours": dict(zip(names, ours, strict=True)), "peer": dict(zip(names, peer, strict=True))}
    return {**pair, "ratio": ratio, "cpu_ratio": per_core, "repeats": 3, "remark": ""}


def test_the_mean_is_judged_by_the_seconds_of_all_cores():
    what = "GP mean, 2 inputs, n = 1000, 5000 points"
    found = {"what": what, "peer_name": "scikit-learn predict", **costs((1, 2, 100), (20, 20, 100), 20.0, 10.0)}
    record = results.judged(found, "sampler")
    assert (record["aim_kind"], record["aim"], record["met"]) == (PER_CORE, 12, False)
    assert results.judged(found | {"cpu_ratio": 12.5}, "sampler")["met"] is True


def test_seconds_of_samplers_are_those_that_their_ratio_is_of():
    what = {"what": "SMC, 5000 particles, 20 moves, ζ 0.995", "peer_name": "BlackJAX, K factorised at each call"}
    each = results.judged(what | costs((8.0, 16.0, 400), (4.0, 8.0, 10), 20.0, 20.0), "sampler")
    assert (each["ours"], each["peer"], each["unit"]) == (0.02, 0.4, "s per evaluation")
    assert (each["cpu_ours"], each["aim"], each["met"]) == (0.04, 10, True)
    whole = results.judged(what | costs((8.0, 16.0, 400), (4.0, 8.0, 10), 0.5, 0.5), "sampler")
    assert (whole["ours"], whole["peer"], whole["unit"], whole["met"]) == (8.0, 4.0, "s", False)


def test_runs_from_anchors_are_measured_beside_those_without(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forward, "POINTS", 8)
    cold = forward.pace(Biofilm(mesh="coarse"), forward.design(8))
    found = {figure.what: figure.value for figure in forward.anchored_figures("coarse", "coarse", cold)}
    assert found["solving the anchors, once"] > 0.1  # in a process that has none yet
    assert found["runs without a Jacobian"] >= 5
    assert 0.0 < found["largest difference to a run without"] < 1e-4


def test_campaigns_that_end_otherwise_are_infinitely_far_apart() -> None:
    requests = [RunRequest(str(k), {"E": E, "nu": 0.3, "V_in": 100.0}) for k, E in enumerate((400.0, 60.0))]
    records = list(InProcess()(Biofilm(mesh="coarse"), requests))
    moved = [replace(records[0], interfaces={"": Interface.polyline(records[0].interface.points + 1e-3)}), records[1]]
    assert [record.ok for record in records] == [True, False]
    assert forward.difference(records, moved[::-1]) == pytest.approx(1e-3)
    assert (
        forward.difference(records, [replace(one, key=records[1 - k].key) for k, one in enumerate(records)]) == np.inf
    )


def test_aims_are_those_of_the_forward_model_and_each_is_of_one_figure_only():
    bounds = {mesh: next(a.bound for a in AIMS if a.name == f"runs of the {mesh} mesh") for mesh in forward.AIMS}
    assert bounds == forward.AIMS
    assert len({aim.name for aim in AIMS}) == len(AIMS)
    assert {aim.part for aim in AIMS} <= set(PARTS)
    assert {aim.kind for aim in AIMS} == {RATIO, PER_CORE, MOST, LEAST}


def test_an_aim_holds_at_its_bound_and_not_beyond():
    record = {"part": "p", "what": "task", "ours": 2.0, "ratio": None, "unit": "s"}
    most, least = (Aim("a", "p", "TASK", kind, 2.0, "s") for kind in (MOST, LEAST))
    assert aim_of(record, [least]) is least
    assert most.met(record) is least.met(record) is True
    assert most.met(record | {"ours": 2.1}) is False
    assert least.met(record | {"ours": 1.9}) is False
    assert aim_of(record | {"unit": "MiB"}, [most]) is None
    assert aim_of(record | {"peer_name": "other"}, [most]) is None


def test_figures_of_one_part_leave_those_of_the_other(tmp_path):
    output, parts = tmp_path / "results.json", ("inference", "startup")
    results.save("startup", [{"what": "--help", "value": 0.1, "unit": "s"}], parts=parts, results=output)
    results.save("inference", [comparison("a", "b", 2.0)], parts=parts, results=output)
    results.save("inference", [comparison("c", "b", 2.0)], parts=parts, results=output)
    found = results.load(output)
    assert [(one["what"], one["met"]) for one in found] == [("c", None), ("--help", True), ("strandline status", None)]
    assert found[-1]["remark"] == "not measured: there is no such figure"
    results.save(
        "startup",
        [{"what": "status", "case": "plan in the ledger", "value": 0.5, "unit": "s"}],
        parts=parts,
        results=output,
    )
    assert [one["what"] for one in results.load(output)] == ["c", "status", "strandline --help"]


def test_results_are_a_list_of_figures_and_every_aim_has_one():
    found = results.load()
    assert found
    for one in found:
        assert list(one)[:6] == ["what", "ours", "peer", "ratio", "aim", "met"]
        assert one["part"] in PARTS
        assert one["what"]
        assert all(one[key] is None or one[key] > 0 for key in ("ours", "peer", "ratio"))
        assert (one["ratio"] is None) == (one["peer"] is None)
        assert one["met"] in (True, False, None)
        assert one["ours"] is not None or one["remark"].startswith("not measured: ")
        if one["ratio"] is not None:
            np.testing.assert_allclose(one["ratio"], one["peer"] / one["ours"], rtol=1e-6)
    for aim in AIMS:
        own = [one for one in found if aim_of(one) is aim or (one["what"] == aim.name and one["ours"] is None)]
        assert own, aim.name
        for one in own:
            assert one["aim"] == aim.bound
            assert one["met"] is aim.met(one)


def test_the_page_has_the_tables_of_the_results():
    written = page.PAGE.read_text("utf-8")
    tables = list(page.tables(results.load(), json.loads(results.MACHINE.read_text("utf-8"))))
    for table in tables:
        assert f"<!-- table: {table.name} -->\n{table.markdown()}\n<!-- end -->" in written
    assert written.count("<!-- table: ") == len(tables)


def test_a_row_of_the_page_tells_a_missed_aim_and_what_was_not_measured():
    missed = results.judged(comparison(PRODUCT, "GPJax", 4.9, case="1 core"), "surrogate")
    assert page.aim_row(missed) == (f"{PRODUCT}, 1 core", "GPJax", "4.9", "ratio ≥ 5", "**no**")
    absent = results.judged(comparison(PRODUCT, "GPJax", None, remark="not measured: no wheel"), "surrogate")
    assert page.aim_row(absent)[2:] == ("", "ratio ≥ 5", "not measured")
    assert page.row(absent)[2:] == ("", "", "", "", "not measured: no wheel")


@pytest.mark.parametrize(
    ("value", "unit", "shown"),
    [
        (1.234, "s", "1.23 s"),
        (0.0456, "s", "45.6 ms"),
        (3e-5, "s per evaluation", "30.0 µs per evaluation"),
        (1234.5, "MiB", "1234 MiB"),
        (7.1e10, "per core-second", "7.1e+10 per core-second"),
        (None, "s", ""),
    ],
)
def test_amounts_have_three_digits_and_the_unit_that_suits_them(value, unit, shown):
    assert page.amount(value, unit) == shown


def test_the_figure_of_the_scaling_is_drawn(tmp_path):
    points = [{"x": x, "seconds": 1e-3 * x, "operations": 10.0 * x} for x in (10, 20, 40)]
    series = [{"name": a, "axis": a, "limit": "GEMM" if a != "inputs" else None, "points": points} for a in plots.AXES]
    plots.draw({"peaks": {"GEMM": 2e4}, "series": series}, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_medians_and_ratio_of_pairs():
    found = summarised("a", "b", [(1.0, 4.0), (2.0, 9.0), (5.0, 5.0)], cpu=[(2.0, 2.0)], case="c")
    assert found == Comparison("a", "b", 2.0, 5.0, 2.5, 3, "c", "", 2.0, 2.0)
    record = results.judged(vars(found), "inference")
    assert (record["ratio_per_core"], record["case"], record["unit"]) == (1.0, "c", "s")
    assert unmeasured("a", "b", NotMeasured("why")).remark == "not measured: why"


PEER = """
from worker import serve
def prepare(content):
    print("a library talks")
    return lambda: [float(content["x"].sum()), FACTOR * 2.0]
if __name__ == "__main__":
    serve(("numpy",), prepare)
"""


@pytest.fixture
def peers(tmp_path, monkeypatch):
    worker = (workers.PEERS / "worker.py").read_text("utf-8")
    files = {"worker": worker, "same": PEER.replace("FACTOR", "1"), "other": PEER.replace("FACTOR", "1.01")}
    for name, text in (files | {"absent": "import no_such_package"}).items():
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.setattr(workers, "PEERS", tmp_path)
    return Path(sys.executable)


def test_programs_in_processes_of_their_own_take_turns(peers):
    found = workers.versus("task", "peer", ("same.py", "same.py"), {"x": np.ones(3)}, cores=1, python=peers, repeats=2)
    assert (found.what, found.case, found.repeats, found.remark) == ("task", "1 core", 2, f"numpy {np.__version__}")
    assert found.ours > 0
    assert found.cpu_peer is not None


def test_programs_that_disagree_are_not_compared(peers):
    with pytest.raises(AssertionError, match="tolerance"):
        workers.versus("task", "peer", ("same.py", "other.py"), {"x": np.ones(3)}, cores=1, python=peers, repeats=1)


def test_a_peer_that_is_not_there_is_said_to_be_not_measured(peers, tmp_path):
    with pytest.raises(NotMeasured, match="no_such_package"):
        workers.versus("task", "peer", ("same.py", "absent.py"), {"x": np.ones(3)}, cores=1, python=peers)
    with pytest.raises(NotMeasured, match="make bench-env"):
        workers.versus("task", "peer", ("same.py",) * 2, {"x": np.ones(3)}, cores=1, python=tmp_path / "no")
    with pytest.raises(RuntimeError, match="own side"):
        workers.versus("task", "peer", ("absent.py", "same.py"), {"x": np.ones(3)}, cores=1, python=peers)


def test_what_cannot_be_installed_is_kept_with_its_reason(tmp_path, monkeypatch):
    monkeypatch.setattr(install.venv, "create", lambda folder, with_pip: Path(folder).mkdir(exist_ok=True))
    lists = [tmp_path / "good.txt", tmp_path / "bad.txt"]
    for one in lists:
        one.write_text(f"{one.stem}==1\n", encoding="utf-8")
    asked = []

    def pip(command):
        asked.append(Path(command[-1]).name)
        said = (
            "Looking in indexes: x://y/z\nERROR: No matching distribution found for bad==1 (from versions: 2)\nnotice"
        )
        return subprocess.CompletedProcess(command, int(command[-1].endswith("bad.txt")), "", said)

    missing = install.install(tmp_path / "env", lists=lists, runner=pip)
    assert missing == {"bad.txt": "ERROR: No matching distribution found for bad==1"}
    assert install.not_installed(tmp_path / "env") == "bad.txt: ERROR: No matching distribution found for bad==1"
    install.install(tmp_path / "env", lists=lists, runner=pip)
    assert asked == ["good.txt", "bad.txt"] * 2
    assert install.install(tmp_path / "env", lists=lists[:1], runner=pip) == {}
    assert install.not_installed(tmp_path / "env") == ""
    install.install(tmp_path / "env", lists=lists[:1], runner=pip)
    assert asked == ["good.txt", "bad.txt"] * 2 + ["good.txt"]
