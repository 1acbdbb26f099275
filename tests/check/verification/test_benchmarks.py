"""The pieces of the benchmark: its parts, aims, results and page."""

import json
import subprocess
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from verification.benchmarks import __main__ as bench
from verification.benchmarks import forward, page, results
from verification.benchmarks.__main__ import PARTS
from verification.benchmarks.aims import AIMS, PER_CORE, aim_of
from verification.benchmarks.comparison import Comparison, NotMeasured, summarised, unmeasured

FIRST_KEYS = ["what", "ours", "peer", "ratio", "aim", "met"]
PRODUCT = "evidence and gradient, matern32_product, n = 2000"


def test_every_part_is_found_by_its_name(monkeypatch):
    """In the process that measures it: by the names that the program gives to Python."""
    commands, saved = [], []
    monkeypatch.setattr(subprocess, "run", lambda words: commands.append(words) or SimpleNamespace(returncode=0))
    monkeypatch.setattr(results, "note_run", lambda *args, **kinds: None)
    monkeypatch.setattr(results, "save", lambda name, records, parts: saved.append((name, records)))
    for part in PARTS:
        assert bench.run(part)
        _, option, package, *arguments = commands.pop()
        assert option == "-m"
        assert Path(str(find_spec(f"{package}.__main__").origin)).samefile(bench.__file__)
        monkeypatch.setattr(f"{package}.{part}.main", lambda part=part: [part])
        assert bench.main(arguments) == 0
        assert saved.pop() == (part, [part])


def comparison(what: str, peer: str, ratio: float | None, **more) -> dict:
    seconds = {"ours": None, "peer": None} if ratio is None else {"ours": 2.0, "peer": 2.0 * ratio}
    return {"what": what, "peer_name": peer, **seconds, "ratio": ratio, "repeats": 3, **more}


def alone(what: str, value: float | None, unit: str, case: str = "") -> dict:
    return {"what": what, "case": case, "value": value, "unit": unit}


PACE = "solves, 2 workers"
JUDGED = [
    ("surrogate", comparison(PRODUCT, "JAX, autodiff of a Cholesky", 5.1), 5, True),
    ("surrogate", comparison(PRODUCT, "GPJax", 4.9), 5, False),
    ("surrogate", comparison(PRODUCT, "scikit-learn", 9.0), 10, False),
    ("surrogate", comparison(PRODUCT, "GPyTorch", 3.0), None, None),
    ("surrogate", comparison(PRODUCT.replace("2000", "20000"), "GPJax", 3.0), None, None),
    ("surrogate", comparison(PRODUCT, "GPJax", None, remark="not measured: no wheel"), 5, None),
    ("surrogate", comparison(PRODUCT.replace("2000", "5000"), "dpotrf + dpotri alone", 0.72), 1 / 1.4, True),
    ("inference", comparison(PRODUCT, "GPJax", 1.0), None, None),
    ("norms", comparison("currents: d², 10082² triangles, width 0.3", "all pairs in NumPy, blocks", 5.0), 5, True),
    ("norms", alone("currents: d², 100352² triangles", 1200.0, "MiB"), 1000, False),
    ("norms", alone("currents: d², 100352² triangles", 4.0, "s"), None, None),
    ("norms", comparison("closest points: 6600 to 2000 segments", "all pairs in NumPy, blocks", 14.0), 15, False),
    ("startup", alone("strandline --help", 0.15, "s"), 0.15, True),
    ("startup", alone("strandline status", 0.7, "s", "plan in the ledger"), 0.6, False),
    ("forward", alone(PACE, 1e3, "per minute", "coarse, umfpack"), 1100, False),
    ("forward", alone(PACE, 400.0, "per minute", "default, umfpack"), 400, True),
    ("forward", alone(PACE, None, "per minute", "default, mkl"), 400, None),
]


def test_a_figure_has_its_aim_and_is_judged_by_it():
    for part, found, bound, met in JUDGED:
        record = results.judged(found, part)
        assert list(record)[:6] == FIRST_KEYS
        assert record["aim"] is bound is None or record["aim"] == pytest.approx(bound, rel=1e-4), found
        assert record["met"] is met, found


def costs(ours: tuple[float, float, int], peer: tuple[float, float, int], ratio: float, per_core: float) -> dict:
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
    assert (each["ours"], each["peer"], each["unit"]) == (0.02, 0.4, "s per evaluation")
    assert (each["cpu_ours"], each["aim"], each["met"]) == (0.04, 10, True)
    whole = results.judged(what | costs((8.0, 16.0, 400), (4.0, 8.0, 10), 0.5, 0.5), "sampler")
    assert (whole["ours"], whole["peer"], whole["unit"], whole["met"]) == (8.0, 4.0, "s", False)


def test_figures_of_one_part_leave_those_of_the_other(tmp_path):
    kept = {"parts": ("inference", "startup"), "results": tmp_path / "results.json"}
    results.save("startup", [alone("--help", 0.1, "s")], **kept)
    results.save("inference", [comparison("a", "b", 2.0)], **kept)
    results.save("inference", [comparison("c", "b", 2.0)], **kept)
    found = results.load(kept["results"])
    assert [(one["what"], one["met"]) for one in found] == [("c", None), ("--help", True), ("strandline status", None)]
    assert found[-1]["remark"] == "not measured: there is no such figure"
    results.save("startup", [alone("status", 0.5, "s", "plan in the ledger")], **kept)
    assert [one["what"] for one in results.load(kept["results"])] == ["c", "status", "strandline --help"]


def test_results_are_a_list_of_figures_and_every_aim_has_one():
    found = results.load()
    assert found
    for one in found:
        assert list(one)[:6] == FIRST_KEYS
        assert one["part"] in PARTS
        assert one["what"]
        assert all(one[key] is None or one[key] > 0 for key in ("ours", "peer", "ratio"))
        assert (one["ratio"] is None) == (one["peer"] is None)
        assert one["met"] in (True, False, None)
        assert one["ours"] is not None or one["remark"].startswith("not measured: ")
        if one["ratio"] is not None:
            np.testing.assert_allclose(one["ratio"], one["peer"] / one["ours"], rtol=1e-6)
    assert len({aim.name for aim in AIMS}) == len(AIMS)
    bounds = {aim.name: aim.bound for aim in AIMS}
    assert {mesh: bounds[f"runs of the {mesh} mesh"] for mesh in forward.AIMS} == forward.AIMS
    for aim in AIMS:
        own = [one for one in found if aim_of(one) is aim or (one["what"] == aim.name and one["ours"] is None)]
        assert own, aim.name
        assert all(one["aim"] == aim.bound and one["met"] is aim.met(one) for one in own)


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


def test_amounts_have_three_digits_and_the_unit_that_suits_them():
    assert page.amount(1.234, "s") == "1.23 s"
    assert page.amount(0.0456, "s") == "45.6 ms"
    assert page.amount(3e-5, "s per evaluation") == "30.0 µs per evaluation"
    assert page.amount(1234.5, "MiB") == "1234 MiB"
    assert page.amount(7.1e10, "per core-second") == "7.1e+10 per core-second"
    assert page.amount(None, "s") == ""


def test_medians_and_ratio_of_pairs():
    found = summarised("a", "b", [(1.0, 4.0), (2.0, 9.0), (5.0, 5.0)], cpu=[(2.0, 2.0)], case="c")
    assert found == Comparison("a", "b", 2.0, 5.0, 2.5, 3, "c", "", 2.0, 2.0)
    record = results.judged(vars(found), "inference")
    assert (record["ratio_per_core"], record["case"], record["unit"]) == (1.0, "c", "s")
    assert unmeasured("a", "b", NotMeasured("why")).remark == "not measured: why"
