"""A study served by UM-Bridge, and the same study calibrated through it."""

import contextlib
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import umbridge
import yaml
from tests.study.conftest import SAMPLER

from strandline.models.umbridge.answers import answer
from strandline.runs import InProcess, Ledger
from strandline.studies import load_study, run_study
from strandline.studies.foresight.serve import Solver, served_models
from strandline.testing.models import Cantilever, Counted, Faulty, Slow, TwoLoads
from strandline.testing.studies import TWO_LOADS_STUDY, beam, write_study
from strandline.testing.umbridge import CHECKS, STRICT_CHECKS, ModelUnderTest

COMMAND = [sys.executable, "-c", "from strandline.cli import main; main()"]
LOAD = 1e-5
GUIDE = Path(__file__).parents[3] / "docs" / "how-to" / "own-simulator.md"


@contextlib.contextmanager
def serving(folder, *options):
    """Yield address and announcement of `strandline serve`; it must end at Ctrl-C with one line."""
    command, pipe = [*COMMAND, "serve", str(folder), "--port", "0", *options], subprocess.PIPE
    process = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True)
    try:
        told = [process.stdout.readline()]
        while told[-1] and not told[-1].startswith("  log_likelihood"):
            told.append(process.stdout.readline())
        yield told[0].split()[-1], told
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=30)
        assert (process.returncode, out, error) == (0, "", "stopped\n")
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def two_loads(tmp_path_factory):
    with serving(write_study(tmp_path_factory.mktemp("served"), **TWO_LOADS_STUDY), "--workers", "2") as (url, _):
        yield url


def test_a_served_study_conforms_and_tells_callers_of_their_mistakes(two_loads):
    for name in ("interface:heavy", "log_likelihood"):
        model = ModelUnderTest(two_loads, name, [[410.0]])
        for check in (*CHECKS.values(), *STRICT_CHECKS.values()):
            check(model)
    response = model.post("Evaluate", {"name": "log_likelihood", "input": [[-1.0]]})
    assert "E (Young's modulus) in (0, inf] Pa" in response.json()["error"]["message"]


@pytest.mark.smoke
def test_the_reference_client_gets_the_studys_numbers(two_loads):
    heavy = umbridge.HTTPModel(two_loads, "interface:heavy")
    run = TwoLoads(sensitivities=True)({"E": 410.0, "load": LOAD}, Path())
    assert heavy([[410.0]])[0] == run.interfaces["heavy"].points.ravel().tolist()
    slope = run.sensitivities["heavy"]["E"].ravel()
    np.testing.assert_allclose(heavy.apply_jacobian(0, 0, [[410.0]], [2.0]), 2.0 * slope, rtol=1e-14)
    np.testing.assert_allclose(heavy.gradient(0, 0, [[410.0]], [1.0] * slope.size), [slope.sum()], rtol=1e-12)
    truth = TwoLoads()({"E": 400.0, "load": LOAD}, Path())
    squares = [np.sum((run.interfaces[c].points - truth.interfaces[c].points) ** 2) for c in TwoLoads.conditions]
    (value,) = umbridge.HTTPModel(two_loads, "log_likelihood")([[410.0]])
    np.testing.assert_allclose(value, [-0.5 * sum(squares) / 0.01**2], rtol=1e-10)


SMALL = {"draft": True, "report": "none", "design": {"sobol": {"runs": 24}}, "sampler": SAMPLER}


@pytest.fixture(scope="module")
def bent(tmp_path_factory):
    with serving(write_study(tmp_path_factory.mktemp("bent"), **SMALL)) as served:
        yield served


def test_a_study_calibrated_through_um_bridge_is_the_same_study(bent, tmp_path):
    options = {"url": bent[0], "name": "interface", "inputs": [{"E": "Pa"}, {"tilt": 1}]}
    observation = {"synthetic": {"E": 400, "tilt": 0.02}}
    content = {**SMALL, "model": {"umbridge": options}, "fixed": None, "observation": observation}
    study = load_study(write_study(tmp_path, **content))
    run_study(study, executor=InProcess())
    with Ledger.open(study.ledger_path, model=study.model.fingerprint, read_only=True) as ledger:
        records = list(ledger.latest(study.runs.needed_keys).values())
    assert len(records) == 25
    for record in records:
        own = beam({**record.inputs, "load": LOAD}, Path()).interface
        np.testing.assert_array_equal(record.interfaces[""].points, own.points)


def test_the_pieces_of_the_guide_work(bent, tmp_path):
    guide, (url, (_, *told)) = GUIDE.read_text("utf-8"), bent
    assert told[1] == "  interface: 34 numbers; Evaluate\n"
    assert "".join(told) in guide
    (piece,) = re.findall(r"```yaml\n(model:\n  umbridge:.*?)```", guide, re.DOTALL)
    load_study(write_study(tmp_path, **yaml.safe_load(piece), observation={"synthetic": {"E": 400, "nu": 0.3}}))
    programs, shown = re.findall(r"```python\n((?:import|from) [\w. ]*umbridge.*?)```", guide, re.DOTALL), {}
    assert len(programs) == 2
    exec("\n".join(programs).replace("http://127.0.0.1:4242", url), shown)
    tip = beam({"E": 400.0, "tilt": 0.02, "load": LOAD}, Path()).interface.points
    points = beam({"E": 410.0, "tilt": 0.02, "load": LOAD}, Path()).interface.points
    assert shown["value"] == pytest.approx(-0.5 * np.sum((points - tip) ** 2) / 0.003**2, rel=1e-9)


def test_a_served_command_keeps_folders_of_failed_runs_and_says_so(tmp_path):
    script = "test {{ E }} = 2.0 && { echo no licence; exit 4; }; printf '0,0\\n1,{{ E }}\\n' > out.csv"
    command = {"command": script, "shell": True, "result": {"file": "out.csv", "unit": "mm"}}
    content = {"model": {"command": command}, "inputs": {"E": {"prior": {"uniform": [0, 3]}}}}
    folder = write_study(tmp_path, **content, fixed=None, observation={"synthetic": {"E": 1}})
    with serving(folder) as (url, told):
        assert told[2] == f"  folders of failed runs are kept in {folder / 'runs'}\n"
        model = ModelUnderTest(url, "interface", [[1.0]])
        assert model.ask("Evaluate", input=[[1.0]])["output"] == [[0.0, 0.0, 1.0, 1.0]]
        answered = model.post("Evaluate", {"name": "interface", "input": [[2.0]]}).json()["error"]["message"]
    (kept,) = (folder / "runs").iterdir()
    assert answered.splitlines()[1:] == [f"its folder: {kept}", "last lines of its log:", "no licence"]


def asked(solver, modulus):
    return solver({"E": modulus, "load": LOAD})


@pytest.mark.smoke
def test_runs_of_several_callers_are_their_own_and_made_once(tmp_path):
    model = Counted(str(tmp_path), Slow(Cantilever(), seconds=0.05))
    stiffness = [300.0, 400.0, 300.0, 500.0, 400.0, 300.0]
    with contextlib.closing(Solver(model, workers=2)) as solver, ThreadPoolExecutor(6) as pool:
        records = list(pool.map(lambda modulus: asked(solver, modulus), stiffness))
    for modulus, record in zip(stiffness, records, strict=True):
        np.testing.assert_array_equal(record.interfaces[""].points, Cantilever().outline(modulus, LOAD).points)
    assert len((tmp_path / "calls").read_text("utf-8").splitlines()) == 3


@pytest.mark.parametrize(("fault", "kind"), [("segfault", "worker_died"), ("hang", "timeout")])
def test_a_run_that_goes_wrong_costs_itself(tmp_path, fault, kind):
    with contextlib.closing(Solver(Faulty(fault=fault), timeout=1.5)) as solver:
        one, wrong, other = (asked(solver, modulus) for modulus in (400.0, 600.0, 410.0))
        assert (one.ok, wrong.failure_kind, other.ok) == (True, kind, True)
        models = served_models(load_study(write_study(tmp_path)), solver)
        given = answer(models, "POST", "/Evaluate", b'{"name": "log_likelihood", "input": [[550.0, 0.0]]}')
        assert (given.status, given.content["error"]["type"]) == (500, "ModelError")


def test_closing_ends_a_run_that_is_being_made(tmp_path):
    solver = Solver(Counted(str(tmp_path), Faulty(fault="hang")))
    with ThreadPoolExecutor(1) as pool:
        run = pool.submit(asked, solver, 600.0)
        while not (tmp_path / "calls").exists():
            time.sleep(0.05)
        solver.close()
        assert not run.result(timeout=10).ok
