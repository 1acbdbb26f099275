"""A study served by UM-Bridge, and the same study calibrated through it."""

import contextlib
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import umbridge
import yaml

from strandline.errors import InvalidInput
from strandline.models.umbridge.answers import answer
from strandline.runs import InProcess, Ledger, RunRecord
from strandline.studies import load_study, run_study
from strandline.studies.serve import Solver, served_models
from strandline.testing.models import Cantilever, Counted, Faulty, Slow, TwoLoads
from strandline.testing.studies import TWO_LOADS_STUDY, beam, write_study
from strandline.testing.umbridge import CHECKS, STRICT_CHECKS, ModelUnderTest

COMMAND = [sys.executable, "-c", "from strandline.cli import main; main()"]
LOAD = 1e-5
GUIDE = Path(__file__).parents[3] / "docs" / "how-to" / "umbridge.md"


@contextlib.contextmanager
def serving(folder: Path, *options: str) -> Iterator[tuple[str, list[str]]]:
    """Yield address and announcement of `strandline serve`; it must end at Ctrl-C with one line."""
    process = subprocess.Popen(
        [*COMMAND, "serve", str(folder), "--port", "0", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
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
def two_loads(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with serving(write_study(tmp_path_factory.mktemp("served"), **TWO_LOADS_STUDY), "--workers", "2") as (url, _):
        yield url


def test_a_served_study_conforms(two_loads: str) -> None:
    for name in ("interface:light", "interface:heavy", "log_likelihood"):
        model = ModelUnderTest(two_loads, name, [[410.0]])
        for check in (*CHECKS.values(), *STRICT_CHECKS.values()):
            check(model)


@pytest.mark.smoke
def test_the_reference_client_gets_the_studys_numbers(two_loads: str) -> None:
    heavy, light = (umbridge.HTTPModel(two_loads, f"interface:{name}") for name in ("heavy", "light"))
    run = TwoLoads(sensitivities=True)({"E": 410.0, "load": LOAD}, Path())
    assert heavy([[410.0]])[0] == run.interfaces["heavy"].points.ravel().tolist()
    assert light([[410.0]])[0] == run.interfaces["light"].points.ravel().tolist()
    slope = run.sensitivities["heavy"]["E"].ravel()
    np.testing.assert_allclose(heavy.apply_jacobian(0, 0, [[410.0]], [2.0]), 2.0 * slope, rtol=1e-14)
    np.testing.assert_allclose(heavy.gradient(0, 0, [[410.0]], [1.0] * slope.size), [slope.sum()], rtol=1e-12)
    truth = TwoLoads()({"E": 400.0, "load": LOAD}, Path())
    squares = [np.sum((run.interfaces[c].points - truth.interfaces[c].points) ** 2) for c in TwoLoads.conditions]
    (value,) = umbridge.HTTPModel(two_loads, "log_likelihood")([[410.0]])
    np.testing.assert_allclose(value, [-0.5 * sum(squares) / 0.01**2], rtol=1e-10)


def test_values_that_the_model_does_not_take_are_the_callers_mistake(two_loads: str) -> None:
    response = ModelUnderTest(two_loads, "log_likelihood", [[0.0]]).post(
        "Evaluate", {"name": "log_likelihood", "input": [[-1.0]]}
    )
    assert response.status_code == 400
    assert "E (Young's modulus) in (0, inf] Pa" in response.json()["error"]["message"]


SMALL: dict[str, Any] = {
    "draft": True,
    "report": "none",
    "design": {"sobol": {"runs": 24}},
    "sampler": {"smc": {"particles": 1000, "rejuvenation_steps": 3, "zeta": 0.6}},
}


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str, list[str]]]:
    """Folder, address and announcement of a served study."""
    folder = write_study(tmp_path_factory.mktemp("bent"), **SMALL)
    with serving(folder) as (url, told):
        yield folder, url, told


def test_a_served_study_announces_what_it_serves(bent: tuple[Path, str, list[str]]) -> None:
    assert bent[2][1:] == [
        "  inputs: [E [Pa], tilt]\n",
        "  interface: 34 numbers; Evaluate\n",
        "  log_likelihood: 1 number; Evaluate\n",
    ]
    assert "".join(bent[2][1:]) in GUIDE.read_text("utf-8")


def test_a_study_calibrated_through_um_bridge_is_the_same_study(
    bent: tuple[Path, str, list[str]], tmp_path: Path
) -> None:
    options = {"url": bent[1], "name": "interface", "inputs": [{"E": "Pa"}, {"tilt": 1}]}
    observation = {"synthetic": {"E": 400, "tilt": 0.02}}
    remote = write_study(tmp_path, model={"umbridge": options}, fixed=None, observation=observation, **SMALL)
    study = load_study(remote)
    summary = run_study(study, executor=InProcess()).summary
    with Ledger.open(study.ledger_path, model=study.model.fingerprint, read_only=True) as ledger:
        records = list(ledger.latest(study.runs.needed_keys).values())
    assert len(records) == 25
    for record in records:
        own = beam({**record.inputs, "load": LOAD}, Path()).interface
        np.testing.assert_array_equal(record.interfaces[""].points, own.points)
    assert summary["inputs"]["E"]["mean"] == pytest.approx(400, rel=0.1)
    assert summary["inputs"]["tilt"]["mean"] == pytest.approx(0.02, abs=0.01)


def test_the_pieces_of_the_guide_work(bent: tuple[Path, str, list[str]], tmp_path: Path) -> None:
    guide = GUIDE.read_text("utf-8")
    (piece,) = re.findall(r"```yaml\n(.*?)```", guide, re.DOTALL)
    content: dict[str, Any] = yaml.safe_load(piece)
    study = load_study(write_study(tmp_path, **content, observation={"synthetic": {"E": 400, "nu": 0.3}}))
    assert study.space.names == ("E", "nu")
    programs = re.findall(r"```python\n(.*?)```", guide, re.DOTALL)
    assert len(programs) == 2
    shown: dict[str, Any] = {}
    exec("\n".join(programs).replace("http://127.0.0.1:4242", bent[1]), shown)
    tip = beam({"E": 400.0, "tilt": 0.02, "load": LOAD}, Path()).interface.points
    points = beam({"E": 410.0, "tilt": 0.02, "load": LOAD}, Path()).interface.points
    assert shown["value"] == pytest.approx(-0.5 * np.sum((points - tip) ** 2) / 0.003**2, rel=1e-9)


def test_a_served_study_without_its_server_is_told_by_check(tmp_path: Path) -> None:
    options = {"url": "http://127.0.0.1:9", "name": "interface", "inputs": ["E", "tilt"]}
    study = write_study(
        tmp_path, model={"umbridge": options}, fixed=None, observation={"synthetic": {"E": 400, "tilt": 0}}
    )
    ended = subprocess.run([*COMMAND, "check", str(study)], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2
    assert "no UM-Bridge server answers at http://127.0.0.1:9" in ended.stderr
    assert ended.stderr.count("\n") == 1


def test_a_served_command_keeps_folders_of_failed_runs_and_says_so(tmp_path: Path) -> None:
    script = "test {{ E }} = 2.0 && { echo no licence; exit 4; }; printf '0,0\\n1,{{ E }}\\n' > out.csv"
    command = {"command": script, "shell": True, "result": {"file": "out.csv", "unit": "mm"}}
    priors = {"E": {"prior": {"uniform": [0, 3]}}}
    observation = {"synthetic": {"E": 1}}
    folder = write_study(tmp_path, model={"command": command}, inputs=priors, fixed=None, observation=observation)
    with serving(folder) as (url, told):
        assert told[2] == f"  folders of failed runs are kept in {folder / 'runs'}\n"
        model = ModelUnderTest(url, "interface", [[1.0]])
        assert model.ask("Evaluate", input=[[1.0]])["output"] == [[0.0, 0.0, 1.0, 1.0]]
        assert not (folder / "runs").exists()
        answered = model.post("Evaluate", {"name": "interface", "input": [[2.0]]}).json()["error"]["message"]
    (kept,) = (folder / "runs").iterdir()
    first, *rest = answered.splitlines()
    assert first.startswith("exit_code: ")
    assert rest == [f"its folder: {kept}", "last lines of its log:", "no licence"]


@pytest.mark.parametrize(
    ("options", "code", "what"),
    [(["--port", "70000"], 2, "70000"), (["--host", "nowhere.invalid"], 2, "address to serve on")],
)
def test_addresses_that_cannot_be_served_are_refused(tmp_path: Path, options: list[str], code: int, what: str) -> None:
    command = [*COMMAND, "serve", str(write_study(tmp_path)), *options]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stderr.count("\n")) == (code, 1)
    assert what in ended.stderr


class TestSolver:
    def ask(self, solver: Solver, modulus: float) -> RunRecord:
        return solver({"E": modulus, "load": LOAD})

    @pytest.mark.smoke
    def test_runs_of_several_callers_are_their_own_and_made_once(self, tmp_path: Path) -> None:
        solver = Solver(Counted(str(tmp_path), Slow(Cantilever(), seconds=0.05)), workers=2)
        stiffness = [300.0, 400.0, 300.0, 500.0, 400.0, 300.0]
        try:
            with ThreadPoolExecutor(6) as pool:
                records = list(pool.map(lambda e: self.ask(solver, e), stiffness))
            again = self.ask(solver, 400.0)
        finally:
            solver.close()
        for modulus, record in zip([*stiffness, 400.0], [*records, again], strict=True):
            np.testing.assert_array_equal(record.interfaces[""].points, Cantilever().outline(modulus, LOAD).points)
        lines = (tmp_path / "calls").read_text("utf-8").splitlines()
        assert len(lines) == 3
        assert len({line.split()[0] for line in lines}) <= 2

    def test_a_run_that_goes_wrong_costs_itself(self, tmp_path: Path) -> None:
        for fault, state, kind in (
            ("segfault", "killed", "worker_died"),
            ("hang", "timeout", "timeout"),
            ("exception", "failed", "exception"),
        ):
            solver = Solver(Faulty(fault=fault), timeout=1.5)
            try:
                records = [self.ask(solver, modulus) for modulus in (400.0, 600.0, 410.0)]
                models = served_models(load_study(write_study(tmp_path)), solver)
                asked = b'{"name": "log_likelihood", "input": [[550.0, 0.0]]}'
                given = answer(models, "POST", "/Evaluate", asked) if fault == "hang" else None
            finally:
                solver.close()
            assert [record.ok for record in records] == [True, False, True]
            assert (records[1].state, records[1].failure_kind) == (state, kind)
            if given is not None:
                error: Any = given.content["error"]
                first, *_, last = error["message"].splitlines()
                assert (given.status, error["type"]) == (500, "ModelError")
                assert (first, last) == ("timeout: still running after 1.5 s, and killed", "waiting for nothing")

    @pytest.mark.smoke
    def test_a_model_that_cannot_be_loaded_is_told_each_time(self) -> None:
        solver = Solver(Unloadable())
        try:
            for _ in range(2):
                with pytest.raises(InvalidInput, match="could not load the model"):
                    self.ask(solver, 400.0)
        finally:
            solver.close()

    def test_closing_ends_a_run_that_is_being_made(self, tmp_path: Path) -> None:
        solver = Solver(Counted(str(tmp_path), Faulty(fault="hang")))
        with ThreadPoolExecutor(1) as pool:
            asked = pool.submit(self.ask, solver, 600.0)
            while not (tmp_path / "calls").exists():
                time.sleep(0.05)
            solver.close()
            assert not asked.result(timeout=10).ok


class Unloadable:
    """A model that a fresh interpreter cannot make."""

    def __reduce__(self) -> tuple[Any, ...]:
        return int, ("no number",)

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Any:
        raise NotImplementedError
