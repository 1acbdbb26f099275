"""The benchmark: its aims, results and page, and peers, which must give our answer."""

import sys
from pathlib import Path

import numpy as np
import pytest
from verification.benchmarks import page, results, sampler, surrogate, workers
from verification.benchmarks.aims import AIMS, with_aims
from verification.benchmarks.figures import Figure, NotMeasured

from strandline.posterior.quadrature import integrate
from strandline.surrogate import KERNELS

PRODUCT = "evidence and gradient, matern32_product, n = 2000"
JUDGED = [
    ("surrogate", PRODUCT, "JAX, autodiff of a Cholesky", 5.1, 5, True),
    ("surrogate", PRODUCT, "GPJax", 4.9, 5, False),
    ("surrogate", PRODUCT, "GPyTorch", 3.0, None, None),
    ("surrogate", PRODUCT.replace("2000", "20000"), "GPJax", 3.0, None, None),
    ("surrogate", PRODUCT, "GPJax", None, 5, None),
]


def judged(figure):
    """Return the bound of a figure's aim, and whether it is met."""
    return next(((aim.bound, aim.met(one)) for one, aim in with_aims([figure]) if one is figure), (None, None))


def test_a_figure_has_its_aim_and_is_judged_by_it():
    for part, what, peer, ratio, bound, met in JUDGED:
        ours, theirs = (2.0, 2.0 * ratio) if ratio else (None, None)
        figure = Figure(what, ours=ours, peer_name=peer, peer=theirs, repeats=3, part=part)
        assert (*judged(figure), figure.ratio) == (bound, met, ratio), (part, what, peer)
    memory = Figure("currents: d², 100352² triangles", "width 0.3", 1200.0, "MiB", part="norms")
    assert judged(memory) == (1000, False)


def test_a_part_replaces_its_own_figures_and_aims_without_one_are_listed(tmp_path):
    path = tmp_path / "results.json"
    results.save("startup", [Figure("strandline --help", ours=9.0), Figure("strandline runs", ours=1.0)], path)
    results.save("norms", [Figure("currents", remark="no memory")], path)
    results.save("startup", [Figure("strandline --help", ours=0.0, remark="quick")], path)
    norms, startup = found = results.load(path)
    assert (norms.what, norms.ours, results.row(norms)[-1]) == ("currents", None, "not measured: no memory")
    assert (startup.what, startup.ours, judged(startup)[1]) == ("strandline --help", 0.0, True)
    missing = [(one.what, aim.met(one)) for one, aim in with_aims(found) if one not in found]
    assert missing == [(aim.name, None) for aim in AIMS if aim.name != "strandline --help"]


def test_every_aim_has_a_figure_and_the_page_has_the_tables_of_all():
    found = results.load()
    assert {one.part for one in found} == set(results.PARTS)
    assert all(one in found for one, _ in with_aims(found))
    written = page.PAGE.read_text("utf-8")
    tables = list(page.tables(found, results.machine_of_results()))
    for table in tables:
        assert f"<!-- table: {table.name} -->\n{table.markdown()}\n<!-- end -->" in written
    assert written.count("<!-- table: bench_") == len(tables)


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

    def compared(ours, theirs):
        scripts, where = ([f"{ours}.py"], [f"{theirs}.py"]), {"python": Path(sys.executable), "folder": tmp_path}
        return workers.versus("task", "peer", scripts, {"x": np.ones(3)}, cores=1, repeats=2, **where)

    found = compared("same", "same")
    assert (found.what, found.case, found.repeats, found.remark) == ("task", "1 core", 2, f"numpy {np.__version__}")
    with pytest.raises(AssertionError, match="tolerance"):
        compared("same", "other")
    with pytest.raises(NotMeasured, match="no_such_package"):
        compared("same", "absent")


@pytest.fixture(scope="module")
def task():
    return sampler.two_inputs(60, 1000)


def test_peers_have_the_same_evidence_and_mean(task):
    assert all(surrogate.floor(name, 60).ours > 0 for name in KERNELS)
    assert surrogate.scikit_learn("matern32_product", 60).peer_name == "scikit-learn"
    seven = sampler.parts(60, 40)
    assert sampler.mean_beside(seven, sampler.scikit_learn_of_seven(seven), "mean", 1).repeats == 1
    beside_jax = surrogate.in_processes("JAX", "jax", Path(sys.executable), cores=1, runs=60)
    assert beside_jax.remark.startswith("jax ")
    for written in (sampler.naive_mean, sampler.refactoring_mean):
        mean = written(task.process)
        found = np.array([mean(x) for x in task.initial[:8]])
        np.testing.assert_allclose(found, task.process.mean(task.initial[:8]), rtol=1e-9, atol=1e-8)


@pytest.mark.long
def test_whole_runs_of_other_samplers_are_right_and_a_wrong_posterior_stops_the_benchmark(task):
    """Moments and evidence are not off by more than few particles explain."""
    exact = integrate(task.process.mean, np.zeros(2), np.ones(2))
    theirs = sampler.blackjax_run(task, sampler.naive_mean(task.process), 0.5 * exact.sd, 8, 0.9)
    plain, _ = sampler.numpy_run(task, task.process.mean, 0.5 * exact.sd, 8, 0.9)
    for found in (theirs()[0], plain):
        mean, sd = sampler.moments(found)
        np.testing.assert_allclose(mean, exact.mean, atol=0.15 * exact.sd.max())
        np.testing.assert_allclose(sd, exact.sd, rtol=0.15)
        assert found[0] == pytest.approx(exact.log_evidence, abs=0.3)
    wrong, _ = sampler.numpy_run(task, lambda x: 2 * task.process.mean(x), 0.5 * exact.sd, 8, 0.9)
    with pytest.raises(AssertionError):
        sampler.require_right(wrong, exact)
