"""The benchmark: its parts, aims, results and page; the quick commands; and peers, which must give our answer."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from verification.benchmarks import __main__ as bench
from verification.benchmarks import forward, page, results, sampler, startup, surrogate, workers
from verification.benchmarks.aims import AIMS, PER_CORE, aim_of
from verification.benchmarks.comparison import Comparison, NotMeasured, summarised, unmeasured

from strandline.posterior.quadrature import integrate
from strandline.studies import load_study
from strandline.studies.progress import progress_in, progress_of, recorded_plan
from strandline.surrogate import KERNELS

FIRST_KEYS = ["what", "ours", "peer", "ratio", "aim", "met"]
PRODUCT = "evidence and gradient, matern32_product, n = 2000"


def test_every_part_is_found_by_its_name(monkeypatch):
    """In the process that measures it: by the names that the program gives to Python."""
    commands, saved = [], []
    monkeypatch.setattr(subprocess, "run", lambda words: commands.append(words) or SimpleNamespace(returncode=0))
    monkeypatch.setattr(results, "note_run", lambda *args, **kinds: None)
    monkeypatch.setattr(results, "save", lambda name, records, parts: saved.append((name, records)))
    for part in bench.PARTS:
        assert bench.run(part)
        _, option, package, *arguments = commands.pop()
        assert option == "-m"
        assert Path(str(find_spec(f"{package}.__main__").origin)).samefile(bench.__file__)
        monkeypatch.setattr(f"{package}.{part}.main", lambda part=part: [part])
        assert bench.main(arguments) == 0
        assert saved.pop() == (part, [part])


def comparison(what, peer, ratio, **more):
    seconds = {"ours": None, "peer": None} if ratio is None else {"ours": 2.0, "peer": 2.0 * ratio}
    return {"what": what, "peer_name": peer, **seconds, "ratio": ratio, "repeats": 3, **more}


def alone(what, value, unit, case=""):
    return {"what": what, "case": case, "value": value, "unit": unit}


PACE = "solves, 2 workers"
JUDGED = [
    ("surrogate", comparison(PRODUCT, "JAX, autodiff of a Cholesky", 5.1), 5, True),
    ("surrogate", comparison(PRODUCT, "GPJax", 4.9), 5, False),
    ("surrogate", comparison(PRODUCT, "scikit-learn", 9.0), 10, False),
    ("surrogate", comparison(PRODUCT, "GPyTorch", 3.0), None, None),
    ("surrogate", comparison(PRODUCT.replace("2000", "20000"), "GPJax", 3.0), None, None),
    ("surrogate", comparison(PRODUCT, "GPJax", None, remark="not measured: no wheel"), 5, None),
    ("inference", comparison(PRODUCT, "GPJax", 1.0), None, None),
    ("norms", alone("currents: d², 100352² triangles", 1200.0, "MiB"), 1000, False),
    ("norms", alone("currents: d², 100352² triangles", 4.0, "s"), None, None),
    ("startup", alone("strandline --help", 0.15, "s"), 0.15, True),
    ("startup", alone("strandline status", 0.7, "s", "plan in the ledger"), 0.6, False),
    ("forward", alone(PACE, 1e3, "per minute", "coarse, umfpack"), 1100, False),
    ("forward", alone(PACE, None, "per minute", "default, mkl"), 400, None),
]


def test_a_figure_has_its_aim_and_is_judged_by_it():
    for part, found, bound, met in JUDGED:
        record = results.judged(found, part)
        assert list(record)[:6] == FIRST_KEYS
        assert (record["aim"], record["met"]) == (bound, met), found


def costs(ours, peer, ratio, per_core):
    names = ("wall", "cpu", "evaluations")
    pair = {"ours": dict(zip(names, ours, strict=True)), "peer": dict(zip(names, peer, strict=True))}
    return {**pair, "ratio": ratio, "cpu_ratio": per_core, "repeats": 3, "remark": ""}


def test_samplers_are_judged_by_an_evaluation_or_a_run_and_the_mean_by_all_cores():
    what = {"what": "GP mean, 2 inputs, n = 1000, 5000 points", "peer_name": "scikit-learn predict"}
    found = what | costs((1, 2, 100), (20, 20, 100), 20.0, 10.0)
    record = results.judged(found, "sampler")
    assert (record["aim_kind"], record["aim"], record["met"]) == (PER_CORE, 12, False)
    assert results.judged(found | {"cpu_ratio": 12.5}, "sampler")["met"] is True
    what = {"what": "SMC, 5000 particles, 20 moves, ζ 0.995", "peer_name": "BlackJAX, K factorised at each call"}
    each = results.judged(what | costs((8.0, 16.0, 400), (4.0, 8.0, 10), 20.0, 20.0), "sampler")
    assert (each["ours"], each["unit"], each["cpu_ours"], each["met"]) == (0.02, "s per evaluation", 0.04, True)
    whole = results.judged(what | costs((8.0, 16.0, 400), (4.0, 8.0, 10), 0.5, 0.5), "sampler")
    assert (whole["ours"], whole["unit"], whole["met"]) == (8.0, "s", False)


def test_results_are_a_list_of_figures_every_aim_has_one_and_the_page_has_their_tables():
    found = results.load()
    for one in found:
        assert list(one)[:6] == FIRST_KEYS
        assert one["part"] in bench.PARTS
        assert all(one[key] is None or one[key] > 0 for key in ("ours", "peer", "ratio"))
        assert (one["ratio"] is None) == (one["peer"] is None)
        assert one["ours"] is not None or one["remark"].startswith("not measured: ")
        if one["ratio"] is not None:
            np.testing.assert_allclose(one["ratio"], one["peer"] / one["ours"], rtol=1e-6)
    bounds = {aim.name: aim.bound for aim in AIMS}
    assert len(bounds) == len(AIMS)
    assert {mesh: bounds[f"runs of the {mesh} mesh"] for mesh in forward.AIMS} == forward.AIMS
    for aim in AIMS:
        own = [one for one in found if aim_of(one) is aim or (one["what"] == aim.name and one["ours"] is None)]
        assert own, aim.name
        assert all(one["aim"] == aim.bound and one["met"] is aim.met(one) for one in own)
    written = page.PAGE.read_text("utf-8")
    tables = list(page.tables(found, json.loads(results.MACHINE.read_text("utf-8"))))
    for table in tables:
        assert f"<!-- table: {table.name} -->\n{table.markdown()}\n<!-- end -->" in written
    assert written.count("<!-- table: ") == len(tables)


def test_a_row_of_the_page_tells_a_missed_aim_what_was_not_measured_and_amounts_with_three_digits():
    missed = results.judged(comparison(PRODUCT, "GPJax", 4.9, case="1 core"), "surrogate")
    assert page.aim_row(missed) == (f"{PRODUCT}, 1 core", "GPJax", "4.9", "ratio ≥ 5", "**no**")
    absent = results.judged(comparison(PRODUCT, "GPJax", None, remark="not measured: no wheel"), "surrogate")
    assert page.aim_row(absent)[2:] == ("", "ratio ≥ 5", "not measured")
    assert page.row(absent)[2:] == ("", "", "", "", "not measured: no wheel")
    assert page.amount(0.0456, "s") == "45.6 ms"
    assert page.amount(3e-5, "s per evaluation") == "30.0 µs per evaluation"
    assert (page.amount(1234.5, "MiB"), page.amount(None, "s")) == ("1234 MiB", "")


def test_medians_and_ratio_of_pairs():
    found = summarised("a", "b", [(1.0, 4.0), (2.0, 9.0), (5.0, 5.0)], cpu=[(2.0, 2.0)], case="c")
    assert found == Comparison("a", "b", 2.0, 5.0, 2.5, 3, "c", "", 2.0, 2.0)
    record = results.judged(vars(found), "inference")
    assert (record["ratio_per_core"], record["case"], record["unit"]) == (1.0, "c", "s")
    assert unmeasured("a", "b", NotMeasured("why")).remark == "not measured: why"


def test_the_study_of_the_quick_commands_is_one_whose_runs_are_made(tmp_path):
    folder = startup.cantilever_study(tmp_path / "study", 16)
    assert recorded_plan(folder) is not None
    state = progress_in(folder)
    assert (state.planned, state.ok, state.to_do) == (16, 16, 0)
    assert state == progress_of(load_study(folder))
    startup.cantilever_study(folder, 16, make=False, seed=2)
    assert recorded_plan(folder) is None
    assert progress_in(folder).ok == 16


def test_the_median_is_of_the_calls_after_the_first_and_failures_are_not_timed(monkeypatch):
    with pytest.raises(subprocess.CalledProcessError):
        startup.seconds(["raise SystemExit(2)"])
    times = iter([9.0, 1.0, 5.0, 2.0])
    monkeypatch.setattr(startup, "seconds", lambda arguments: next(times))
    figure = startup.measured("a", "b", ["pass"], 3, aim=0.5)
    assert (figure.value, figure.remark) == (2.0, "median of 3, 1 to 5; the first time 9 s; aim 0.5 s")


PEER = """
from worker import serve
def prepare(content):
    print("a library talks")
    return lambda: [float(content["x"].sum()), FACTOR * 2.0]
if __name__ == "__main__":
    serve(("numpy",), prepare)
"""


def test_programs_in_processes_of_their_own_take_turns_and_must_agree_or_be_there(tmp_path):
    worker = (workers.PEERS / "worker.py").read_text("utf-8")
    files = {"worker": worker, "same": PEER.replace("FACTOR", "1"), "other": PEER.replace("FACTOR", "1.01")}
    for name, text in (files | {"absent": "import no_such_package"}).items():
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")

    def compared(ours, theirs, python=sys.executable, repeats=1):
        scripts, where = (f"{ours}.py", f"{theirs}.py"), {"python": Path(python), "folder": tmp_path}
        return workers.versus("task", "peer", scripts, {"x": np.ones(3)}, cores=1, repeats=repeats, **where)

    found = compared("same", "same", repeats=2)
    assert (found.what, found.case, found.repeats, found.remark) == ("task", "1 core", 2, f"numpy {np.__version__}")
    assert found.ours > 0
    assert found.cpu_peer is not None
    with pytest.raises(AssertionError, match="tolerance"):
        compared("same", "other")
    with pytest.raises(NotMeasured, match="no_such_package"):
        compared("same", "absent")
    with pytest.raises(NotMeasured, match="make bench-env"):
        compared("same", "same", python=tmp_path / "no")
    with pytest.raises(RuntimeError, match="own side"):
        compared("absent", "same")


@pytest.fixture(scope="module")
def task():
    return sampler.two_inputs(60, 1000)


@pytest.fixture(scope="module")
def exact(task):
    return integrate(task.process.mean, np.zeros(2), np.ones(2))


def test_peers_have_the_same_evidence_and_mean(task):
    assert all(surrogate.floor(name, 60).ours > 0 for name in KERNELS)
    for name in ("matern32_ard", "matern32_product"):
        assert surrogate.scikit_learn(name, 60).peer_name == "scikit-learn"
    for made in (sampler.mean_of_two(60, 40, 1), sampler.mean_of_seven(60, 40, 1)):
        assert made.ratio > 0
        assert made.ours.evaluations == 40
    for written in (sampler.naive_mean, sampler.refactoring_mean):
        mean = written(task.process)
        found = np.array([mean(x) for x in task.initial[:8]])
        np.testing.assert_allclose(found, task.process.mean(task.initial[:8]), rtol=1e-9, atol=1e-8)


@pytest.mark.long
def test_whole_runs_of_other_samplers_are_right(task, exact):
    """Moments and evidence are not off by more than few particles explain."""
    theirs = sampler.blackjax_run(task, sampler.naive_mean(task.process), 0.5 * exact.sd, 8, 0.9)
    plain, cost = sampler.numpy_run(task, task.process.mean, 0.5 * exact.sd, 8, 0.9)
    for found in (theirs()[0], plain):
        mean, sd = sampler.moments(found)
        np.testing.assert_allclose(mean, exact.mean, atol=0.15 * exact.sd.max())
        np.testing.assert_allclose(sd, exact.sd, rtol=0.15)
        assert found[0] == pytest.approx(exact.log_evidence, abs=0.3)
    assert (cost.evaluations - 1000) % 8000 == 0
    assert theirs(2)[1].evaluations == 2 * 1000 * 11


def test_a_wrong_posterior_stops_the_benchmark_and_ratios_are_of_one_evaluation(task, exact):
    wrong, _ = sampler.numpy_run(task, lambda x: 2 * task.process.mean(x), 0.5 * exact.sd, 8, 0.9)
    with pytest.raises(AssertionError):
        sampler.require_right(wrong, exact)
    made = sampler.figure("", "", [(sampler.Cost(2.0, 3.0, 10), sampler.Cost(8.0, 9.0, 20))] * 3, "")
    assert (made.ratio, made.cpu_ratio) == pytest.approx((2.0, 1.5))
