"""Records: the content address, every way in which a model can end, records in files, and the folders of runs."""

import errno
import hashlib
import math
import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.unit.runs.fakes import design, key_of

from strandline.foundations import ForwardModelError, InvalidInput, how_it_ended
from strandline.interface import Interface
from strandline.models.protocol import Simulation
from strandline.runs import InProcess, RunRecord, RunRequest, attempt, run_key, worker
from strandline.runs.executors.slurm_batch import read_run, write_run
from strandline.runs.ledger.record import MESSAGE_CHARACTERS, with_log
from strandline.testing.executors import same_outcome
from strandline.testing.models import Cantilever, TwoLoads

LINE = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 1.0]]))
BOTH = {"slow": LINE, "fast": Interface.polyline(LINE.points[:2] + 1.0)}
SLOPES = {"slow": {"E": np.ones((3, 2))}, "fast": {"E": np.zeros((2, 2))}}
BROKEN = Interface.polyline(LINE.points.copy())
BROKEN.points[1] = np.nan


def outcome(model):
    return attempt(model, RunRequest("k", {"E": 1.0}), Path())


def raising(error):
    def model(inputs, workdir):
        raise error

    return model


@dataclass(frozen=True)
class Returning:
    """A model of two conditions that returns `result`."""

    result: Any
    sensitivities: bool = False
    conditions: ClassVar[tuple[str, ...]] = ("slow", "fast")

    def __call__(self, inputs, workdir):
        return self.result


def test_a_key_tells_runs_apart_to_the_last_bit_and_nothing_else():
    one = run_key("m", {"E": 400.0, "nu": 0.0})
    assert one == run_key("m", {"nu": -0.0, "E": np.float64(400)})
    inputs = [{"E": np.nextafter(400.0, 500.0), "nu": 0.0}, {"E": 0.0, "nu": 400.0}, {"E": 400.0}]
    others = [run_key("m", entry) for entry in (*inputs, {"E": 400.0, "nu ": 0.0})]
    assert len({one, run_key("n", {"E": 400.0, "nu": 0.0}), *others}) == 6
    text = '["m", [["E", "0x1.999999999999ap-4"]]]'
    assert run_key("m", {"E": 0.1}) == hashlib.sha256(text.encode()).hexdigest(), "the same in every process"
    for value in (float("nan"), float("inf")):
        with pytest.raises(InvalidInput, match="input E"):
            run_key("m", {"E": value})


def test_the_cantilever_agrees_with_the_integrated_beam_equation():
    """Oracle: E I w'' = F (L - x), integrated twice by the trapezoidal rule on a fine grid."""
    beam, modulus, load = Cantilever(length=2.0, height=0.2), 500.0, 2e-5
    x, step = np.linspace(0.0, 2.0, 4001, retstep=True)
    curvature = 1000.0 * load * (2.0 - x) / (modulus * 0.2**3 / 12)
    slope = np.concatenate([[0.0], np.cumsum(0.5 * step * (curvature[1:] + curvature[:-1]))])
    sag = np.concatenate([[0.0], np.cumsum(0.5 * step * (slope[1:] + slope[:-1]))])
    np.testing.assert_allclose(beam.deflection(x, modulus, load), sag, atol=1e-7)
    tip = beam.outline(modulus, load).points[beam.nodes - 1 : beam.nodes + 1]
    np.testing.assert_allclose(tip.mean(axis=0), [2.0, sag[-1]], atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(tip[0] - tip[1]), 0.2 * np.hypot(1, slope[-1]), atol=1e-7)


def test_what_a_model_returns_is_kept_and_not_shared_with_it():
    points = LINE.points.copy()
    simulation = Simulation.of(Interface.polyline(points), {"iterations": 7.0})
    simulation.diagnostics["solver"] = "umfpack"  # a text must not cost the interface
    for returned, figures in ((Interface.polyline(points), {}), (simulation, {"iterations": 7.0})):
        record = outcome(lambda inputs, workdir, returned=returned: inputs.clear() or returned)
        assert (record.ok, record.failure_kind, record.message) == (True, None, None)
        assert (dict(record.inputs), dict(record.diagnostics)) == ({"E": 1.0}, figures)
        assert record.seconds >= 0
        points[:] = 7.0
        assert record.interface.points.tobytes() == LINE.points.tobytes()
        points[:] = LINE.points


def test_all_conditions_and_sensitivities_are_kept_asked_for_or_not():
    record = outcome(Returning(Simulation(BOTH, {"steps": 2.0}, SLOPES), sensitivities=True))
    assert record.ok
    assert list(record.interfaces) == ["slow", "fast"]
    assert record.interface is record.interfaces["slow"]
    np.testing.assert_array_equal(record.interfaces["fast"].points, BOTH["fast"].points)
    np.testing.assert_array_equal(record.sensitivities["slow"]["E"], np.ones((3, 2)))
    assert record.sensitivities["slow"]["E"] is not SLOPES["slow"]["E"]
    assert outcome(Returning(Simulation(BOTH))).sensitivities == {}
    assert list(outcome(Returning(Simulation(BOTH, {}, SLOPES))).sensitivities) == ["slow", "fast"]
    assert outcome(Returning(changed(sensitivities={"slow": {"E": np.ones(3)}}))).failure_kind == "sensitivities"


def changed(**changes):
    """Return a simulation with contents that its annotations do not admit."""
    simulation = Simulation(dict(BOTH), {}, {name: dict(by_input) for name, by_input in SLOPES.items()})
    for name, value in changes.items():
        object.__setattr__(simulation, name, value)
    return simulation


UNPROMISED = [
    (LINE, "conditions", "one unnamed condition; expected slow, fast"),
    (Simulation({"slow": LINE}), "conditions", "interfaces of slow; expected slow, fast"),
    (Simulation({"slow": LINE, "a/b": LINE}), "conditions", "'a/b'; expected a short name without slashes"),
    (Simulation({"slow": LINE, "fast": BROKEN}), "non_finite", "2 of 6 coordinates of the interface of fast are not"),
    (Simulation({}), "not_an_interface", "Simulation without interfaces"),
    (changed(interfaces={**BOTH, "fast": None}), "not_an_interface", "Simulation"),
    (changed(sensitivities={"slow": SLOPES["slow"]}), "sensitivities", "none for at least one condition"),
    (changed(sensitivities=None), "sensitivities", "none for at least one condition"),
    (changed(sensitivities=SLOPES | {"fast": {"E": np.ones((3, 2))}}), "sensitivities", "(3, 2); expected (2, 2)"),
    (changed(sensitivities=SLOPES | {"fast": {"E": BROKEN.points[:2]}}), "sensitivities", "2 numbers of d/dE of"),
    (changed(sensitivities=SLOPES | {"fast": {"F": np.ones((2, 2))}}), "sensitivities", "called 'F'"),
]


def test_what_is_not_promised_is_invalid():
    for result, kind, words in UNPROMISED:
        record = outcome(Returning(result, sensitivities=True))
        assert (record.state, record.failure_kind) == ("invalid", kind)
        assert words in record.message
        assert (record.interfaces, record.sensitivities) == ({}, {})
    record = outcome(lambda inputs, workdir: Interface.polyline(np.array([[0.0, np.nan], [1.0, 0.0]])))
    assert (record.state, record.failure_kind) == ("invalid", "invalid_interface")
    assert "point 1 " in record.message


def test_an_exception_is_a_failure_with_a_bounded_message_that_can_be_stored():
    record = outcome(raising(ForwardModelError("limit_point", "no equilibrium", {"load": 0.7})))
    assert (record.state, record.failure_kind, record.message) == ("failed", "limit_point", "no equilibrium")
    assert dict(record.diagnostics) == {"load": 0.7}
    for error in (ValueError("x" * 10**6), KeyError("\ud800"), SystemExit(3), OSError(errno.ENOENT, "no file")):
        record = outcome(raising(error))
        assert (record.state, record.failure_kind) == ("failed", "exception")
        assert type(error).__name__ in record.message
        assert "test_record.py" in record.message
        assert len(record.message.encode()) < 2 * MESSAGE_CHARACTERS


def test_the_key_error_of_a_missing_input_says_what_there_is():
    for name, words in (("w", "KeyError: 'w' (the model was given a, b; "), ("a", "KeyError: 'a'\n")):
        message = attempt(raising(KeyError(name)), RunRequest("k", {"a": 1.0, "b": 2.0}), Path()).message
        assert message.startswith(words)


def test_a_lack_of_memory_and_an_interruption_are_not_the_models():
    for error in (MemoryError(), OSError(errno.ENOMEM, "no memory")):
        record = outcome(raising(error))
        assert (record.state, record.failure_kind, record.final) == ("killed", "out_of_memory", False)
        assert type(error).__name__ in record.message
    with pytest.raises(KeyboardInterrupt):
        outcome(raising(KeyboardInterrupt()))


def test_the_log_ends_the_message_of_a_failure_only():
    bad = RunRecord("k", {}, "failed", failure_kind="exception", message="it broke")
    told = with_log(bad, "\n".join(f"step {number}" for number in range(100)))
    lines = told.message.splitlines()
    assert (lines[0], lines[2:]) == ("it broke", [f"step {number}" for number in range(90, 100)])
    assert told.log.startswith("step 0\n")
    good = RunRecord("k", {}, "ok", {"": LINE})
    assert with_log(good, "chatter") is good


INPUTS = {"E": 1000 * (0.1 + 0.2), "load": 1e-5}
RESULT = TwoLoads(sensitivities=True)(INPUTS, Path())
FIGURES = {**RESULT.diagnostics, "none": math.inf}
FILED = {
    "steep": RunRecord("c", INPUTS, "ok", RESULT.interfaces, FIGURES, 1.5, sensitivities=RESULT.sensitivities),
    "one interface": RunRecord("a", INPUTS, "ok", {"": Interface.polyline(np.random.default_rng(1).random((5, 2)))}),
    "failed": RunRecord("b", INPUTS, "failed", {}, {"load": 0.5}, 2.0, "stalled", "it’s ∂-stuck\nlines", "log\n"),
}


def test_a_record_is_read_from_its_file_as_it_was_written(tmp_path):
    for record in FILED.values():
        write_run(tmp_path / "7.run", record)
        found = read_run(tmp_path / "7.run")
        assert same_outcome(found, record)
        assert (found.seconds, found.message, found.log) == (record.seconds, record.message, record.log)
        assert [path.name for path in tmp_path.iterdir()] == ["7.run"]


@settings(max_examples=20)
@given(name=st.sampled_from(["one interface", "failed"]), place=st.floats(0, 1, exclude_max=True), cut=st.booleans())
def test_a_changed_byte_or_a_missing_end_of_a_file_is_seen(tmp_path_factory, name, place, cut):
    path = tmp_path_factory.mktemp("runs") / "7.run"
    write_run(path, FILED[name])
    content = bytearray(path.read_bytes())
    number = int(place * len(content))
    content[number] ^= 1
    path.write_bytes(content[:number] if cut else content)
    with pytest.raises(InvalidInput, match=r"7\.run"):
        read_run(path)


@pytest.fixture
def parent(tmp_path, monkeypatch):
    """Give the folder in which those of runs are made."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_the_next_driver_clears_the_folder_of_one_that_is_gone_and_its_own(parent):
    mine = worker.scratch_folder()
    gone = parent / mine.name.replace(f"-{os.getpid()}-", "-999999999-")
    gone.mkdir()
    (gone / "mesh.msh").write_text("large")
    (inputs,) = design(400)
    (record,) = InProcess()(Cantilever(), [RunRequest(key_of(Cantilever(), inputs), inputs)])
    assert record.ok
    assert list(parent.iterdir()) == [mine]


@pytest.mark.skipif(sys.platform != "linux", reason="the system does not say when a process was started")
def test_a_process_that_has_the_number_of_a_dead_one_does_not_keep_its_folder(parent):
    mine = worker.scratch_folder()
    machine, pid, begun = mine.name.removeprefix(worker.PREFIX).split("-")[:3]
    (parent / f"{worker.PREFIX}{machine}-{pid}-{int(begun) - 1}-abc").mkdir()
    worker.clear_stale(parent)
    assert list(parent.iterdir()) == [mine]


def test_folders_of_other_machines_and_users_and_links_stay(parent, monkeypatch):
    gone = worker.scratch_folder().name.replace(f"-{os.getpid()}-", "-999999999-")
    machine = gone.removeprefix(worker.PREFIX).split("-")[0]
    elsewhere = gone.replace(machine, "0" * 8)
    foreign = [parent / name for name in (elsewhere, "strandline-runs-notes", "strandline-on-call-abc", "target")]
    for folder in foreign:
        folder.mkdir()
    (parent / gone).symlink_to(parent / "target")
    worker.clear_stale(parent)
    assert (parent / gone).is_symlink()
    (parent / gone).unlink()
    (parent / gone).mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(os, "getuid", lambda: 12345)
        worker.clear_stale(parent)
    assert (parent / gone).is_dir()
    worker.clear_stale(parent)
    assert not (parent / gone).exists()
    assert all(folder.is_dir() for folder in foreign)


def test_how_a_worker_ended():
    assert [how_it_ended(code) for code in (None, 3, -9)] == ["exit code None", "exit code 3", "signal SIGKILL"]
