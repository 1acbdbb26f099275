"""Programs that strandline is compared with: they must give its answer, or the benchmark stops."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from verification.benchmarks import sampler, surrogate, workers
from verification.benchmarks.comparison import NotMeasured
from verification.benchmarks.peers import install

from strandline.posterior.quadrature import integrate
from strandline.surrogate import KERNELS

PEER = """
from worker import serve
def prepare(content):
    print("a library talks")
    return lambda: [float(content["x"].sum()), FACTOR * 2.0]
if __name__ == "__main__":
    serve(("numpy",), prepare)
"""


@pytest.fixture
def compared(tmp_path):
    """Compare a peer with ours in a folder of three peers."""
    worker = (workers.PEERS / "worker.py").read_text("utf-8")
    files = {"worker": worker, "same": PEER.replace("FACTOR", "1"), "other": PEER.replace("FACTOR", "1.01")}
    for name, text in (files | {"absent": "import no_such_package"}).items():
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")

    def versus(ours, theirs, python=sys.executable, repeats=1):
        scripts, where = (f"{ours}.py", f"{theirs}.py"), {"python": Path(python), "folder": tmp_path}
        return workers.versus("task", "peer", scripts, {"x": np.ones(3)}, cores=1, repeats=repeats, **where)

    return versus


def test_programs_in_processes_of_their_own_take_turns_and_must_agree(compared):
    found = compared("same", "same", repeats=2)
    assert (found.what, found.case, found.repeats, found.remark) == ("task", "1 core", 2, f"numpy {np.__version__}")
    assert found.ours > 0
    assert found.cpu_peer is not None
    with pytest.raises(AssertionError, match="tolerance"):
        compared("same", "other")


def test_a_peer_that_is_not_there_is_said_to_be_not_measured(compared, tmp_path):
    with pytest.raises(NotMeasured, match="no_such_package"):
        compared("same", "absent")
    with pytest.raises(NotMeasured, match="make bench-env"):
        compared("same", "same", python=tmp_path / "no")
    with pytest.raises(RuntimeError, match="own side"):
        compared("absent", "same")


def test_what_cannot_be_installed_is_kept_with_its_reason(tmp_path, monkeypatch):
    monkeypatch.setattr(install.venv, "create", lambda folder, with_pip: Path(folder).mkdir(exist_ok=True))
    lists, asked = [tmp_path / "good.txt", tmp_path / "bad.txt"], []
    for one in lists:
        one.write_text(f"{one.stem}==1\n", encoding="utf-8")
    why = "ERROR: No matching distribution found for bad==1"

    def pip(command):
        asked.append(Path(command[-1]).name)
        said = f"Looking in indexes: x://y/z\n{why} (from versions: 2)\nnotice"
        return subprocess.CompletedProcess(command, int(command[-1].endswith("bad.txt")), "", said)

    assert install.install(tmp_path / "env", lists=lists, runner=pip) == {"bad.txt": why}
    assert install.not_installed(tmp_path / "env") == f"bad.txt: {why}"
    install.install(tmp_path / "env", lists=lists, runner=pip)
    assert asked == ["good.txt", "bad.txt"] * 2
    for _ in range(2):  # the second time, nothing is to be done
        assert install.install(tmp_path / "env", lists=lists[:1], runner=pip) == {}
    assert install.not_installed(tmp_path / "env") == ""
    assert asked == ["good.txt", "bad.txt"] * 2 + ["good.txt"]


def test_peers_of_the_fit_have_the_same_evidence():
    assert all(surrogate.floor(name, 60).ours > 0 for name in KERNELS)
    for name in ("matern32_ard", "matern32_product"):
        assert surrogate.scikit_learn(name, 60).peer_name == "scikit-learn"


@pytest.fixture(scope="module")
def task() -> sampler.Task:
    return sampler.two_inputs(60, 1000)


@pytest.fixture(scope="module")
def exact(task):
    return integrate(task.process.mean, np.zeros(2), np.ones(2))


def test_peers_of_the_mean_have_the_same_values(task):
    for made in (sampler.mean_of_two(60, 40, 1), sampler.mean_of_seven(60, 40, 1)):
        assert made.ratio > 0
        assert made.ours.evaluations == 40
    for written in (sampler.naive_mean, sampler.refactoring_mean):
        mean = written(task.process)
        found = np.array([mean(x) for x in task.initial[:8]])
        np.testing.assert_allclose(found, task.process.mean(task.initial[:8]), rtol=1e-9, atol=1e-8)


def require_nearly(found, exact):
    """Stop if moments or evidence are off by more than few particles explain."""
    mean, sd = sampler.moments(found)
    np.testing.assert_allclose(mean, exact.mean, atol=0.15 * exact.sd.max())
    np.testing.assert_allclose(sd, exact.sd, rtol=0.15)
    assert found[0] == pytest.approx(exact.log_evidence, abs=0.3)


@pytest.mark.long
def test_whole_runs_of_other_samplers_are_right(task, exact):
    theirs = sampler.blackjax_run(task, sampler.naive_mean(task.process), 0.5 * exact.sd, 8, 0.9)
    require_nearly(theirs()[0], exact)
    plain, cost = sampler.numpy_run(task, task.process.mean, 0.5 * exact.sd, 8, 0.9)
    require_nearly(plain, exact)
    assert (cost.evaluations - 1000) % 8000 == 0
    assert theirs(2)[1].evaluations == 2 * 1000 * 11


def test_a_wrong_posterior_stops_the_benchmark(task, exact):
    wrong, _ = sampler.numpy_run(task, lambda x: 2 * task.process.mean(x), 0.5 * exact.sd, 8, 0.9)
    with pytest.raises(AssertionError):
        sampler.require_right(wrong, exact)


def test_ratios_are_of_one_evaluation():
    made = sampler.figure("", "", [(sampler.Cost(2.0, 3.0, 10), sampler.Cost(8.0, 9.0, 20))] * 3, "")
    assert (made.ratio, made.cpu_ratio) == pytest.approx((2.0, 1.5))
