"""Words under `failures.kinds`: what the code raises is known, and what no run can end with is refused or told."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.unit.studies.refused import message_of, not_refused
from tests.unit.studies.test_refusals import BIOFILM
from verification.validation.command_faults import FAULTS

import strandline
from strandline.cli import main
from strandline.likelihood import set_aside
from strandline.models.biofilm.model import Biofilm
from strandline.models.command.model import CommandModel
from strandline.models.protocol import declared_failure_kinds
from strandline.models.python import PythonModel
from strandline.models.umbridge.model import UMBridgeModel
from strandline.runs import Ledger, RunRecord, RunRequest
from strandline.runs.executors.slurm_array import ENDINGS
from strandline.runs.failures import COMMON_KINDS
from strandline.studies import load_study
from strandline.testing.studies import undeclared_beam, write_study

SOURCES = Path(strandline.__file__).parent
PLACES = {"ForwardModelError": 0, "_failure": 0, "InvalidResult": 0, "_lost": 1, "_ended": 2}
"""Where calls that make a failure have its kind."""
NO_POLICY = {"stopped", "lost"}
"""Of a run that no campaign asked for, and of one that was given up: no policy is asked about these."""


def raised_in(folder: str) -> set[str]:
    """Return the kinds of failure that stand in the sources in `folder`."""
    return {kind for path in (SOURCES / folder).rglob("*.py") for kind in kinds_in(ast.parse(path.read_text("utf-8")))}


def kinds_in(tree: ast.AST) -> Iterator[str]:
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        given = [keyword.value for keyword in call.keywords if keyword.arg in ("kind", "failure_kind")]
        if name in PLACES:
            given += call.args[PLACES[name] : PLACES[name] + 1]
        yield from (node.value for node in given if isinstance(node, ast.Constant) and isinstance(node.value, str))


def test_what_the_code_raises_is_declared() -> None:
    for model, folder in ((Biofilm, "biofilm"), (CommandModel, "command"), (UMBridgeModel, "umbridge")):
        assert raised_in(f"models/{folder}") - {*COMMON_KINDS} == {*model.failure_kinds} - raised_in("readers")
        assert len({*model.failure_kinds, *COMMON_KINDS}) == len(model.failure_kinds) + len(COMMON_KINDS)
    assert raised_in("runs") | {kind for _, kind in ENDINGS.values()} | set_aside.KINDS == {*COMMON_KINDS, *NO_POLICY}
    assert {fault.kind for fault in FAULTS if fault.kind} <= {*CommandModel.failure_kinds, *COMMON_KINDS}


def kinds(*words: str) -> dict[str, Any]:
    return {"failures": {"kinds": dict.fromkeys(words, "abort")}}


def test_a_word_that_the_model_cannot_end_with_is_refused(tmp_path: Path) -> None:
    rows = [
        (kinds("invalid", kind), f"failures.kinds: got {kind}; expected one of failed, timeout, killed, invalid", hint)
        for kind, hint in (("timout", "mean timeout?"), ("limit-point", "limit_point?"), ("exit_code", "Choose"))
    ]
    assert not_refused(tmp_path, rows, **BIOFILM) == []
    known = kinds("failed", "killed", "limit_point", "out_of_memory", "non_finite")
    study = load_study(write_study(tmp_path, **BIOFILM, **known))
    assert study.settings.failures.actions == known["failures"]["kinds"]


class Telling:
    """A beam that says how its runs fail."""

    fingerprint = "test:telling"
    failure_kinds = ("large_deflection",)

    def __call__(self, inputs: Any, workdir: Path) -> Any:
        return undeclared_beam(inputs, workdir)


def test_a_function_may_declare_its_kinds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    function = "strandline.testing.studies:beam"
    assert declared_failure_kinds(PythonModel(function)) is None
    monkeypatch.setattr(function.replace(":", "."), Telling())
    assert declared_failure_kinds(PythonModel(function)) == ("large_deflection",)
    assert message_of(write_study(tmp_path, **kinds("large_deflection"))) == ""
    assert "Did you mean large_deflection" in message_of(write_study(tmp_path, **kinds("large_deflexion")))


def test_check_warns_of_a_word_where_kinds_are_not_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_study(tmp_path / "study", failures={"kinds": {"timeout": {"retry": 1}, "large_deflexion": "abort"}})

    def warnings() -> list[str]:
        main(["check", str(folder)])
        return [line.strip() for line in capsys.readouterr().out.splitlines() if "failures.kinds" in line]

    (line,) = warnings()
    assert line.startswith("warning: failures.kinds.large_deflexion: no run has ended with it yet")
    key = load_study(folder).runs.design_keys[0]
    with Ledger.open(folder / "ledger.sqlite", model="test:beam-1") as ledger:
        ledger.started(RunRequest(key, {"E": 1.0}))
        ledger.finished(RunRecord(key, {"E": 1.0}, "failed", failure_kind="large_deflexion"))
    assert warnings() == []
