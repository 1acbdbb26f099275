"""`strandline retry`: a licence that was missing for a while."""

import json
from pathlib import Path
from typing import Any

import pytest

from strandline.cli import main
from strandline.testing.studies import write_study

LICENSED = """
from pathlib import Path
from strandline.errors import ForwardModelError
from strandline.testing.studies import undeclared_beam

HERE = Path(__file__).parent

def simulate(inputs, workdir):
    with (HERE / "calls").open("a") as file:
        file.write("call\\n")
    if inputs["E"] > ABOVE and not (HERE / "licence").exists():
        raise ForwardModelError("licence", "no licence to be had\\nthe server is down")
    return undeclared_beam(inputs, workdir)
"""
SMALL: dict[str, Any] = {
    "design": {"sobol": {"runs": 32}},
    "sampler": {"smc": {"particles": 200, "rejuvenation_steps": 2, "zeta": 0.5}},
}


def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, name: str, above: float, **changes: Any) -> Path:
    (tmp_path / f"{name}.py").write_text(LICENSED.replace("ABOVE", str(above)))
    monkeypatch.syspath_prepend(tmp_path)
    return write_study(tmp_path / "study", model={"python": {"function": f"{name}:simulate"}}, **SMALL, **changes)


def calls(folder: Path) -> int:
    return len((folder / "calls").read_text().splitlines())


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as caught:
        main(list(arguments))
    shown = capsys.readouterr()
    return int(caught.value.code or 0), shown.err


def test_failed_runs_are_made_once_more_and_the_results_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], without_report: None
) -> None:
    folder = study(tmp_path, monkeypatch, name="some_licensed", above=450.0)
    main(["run", str(folder), "--quiet"])
    before = json.loads((folder / "summary.json").read_text())["runs"]
    assert before["failed"] == before["by_kind"]["licence"] > 0
    made = calls(tmp_path)
    assert refused(capsys, "retry", str(folder), "--kind", "timeout")[0] == 2
    (tmp_path / "licence").touch()
    main(["retry", str(folder), "--kind", "licence", "--quiet"])
    after = json.loads((folder / "summary.json").read_text())["runs"]
    assert (after["ok"], after["failed"], after["new"]) == (32, 0, before["failed"])
    assert calls(tmp_path) == made + before["failed"]


def test_a_synthetic_observation_that_failed_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], without_report: None
) -> None:
    folder = study(tmp_path, monkeypatch, name="licensed_truth", above=350.0)
    for _ in range(2):
        code, message = refused(capsys, "run", str(folder), "--quiet")
        assert code == 2
        assert f"strandline retry {folder} --kind licence" in message
    assert calls(tmp_path) == 1
    (tmp_path / "licence").touch()
    main(["retry", str(folder), "--kind", "licence", "--quiet"])
    assert json.loads((folder / "summary.json").read_text())["runs"]["ok"] == 32


def test_a_study_whose_runs_all_fail_stops_early_with_the_log_and_goes_on_when_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], without_report: None
) -> None:
    changes = {"observation": {"synthetic": {"E": 100, "tilt": 0.02, "load": 1e-5}}}
    folder = study(tmp_path, monkeypatch, name="never_licensed", above=200.0, **changes)
    code, said = refused(capsys, "run", str(folder), "--quiet", "--workers", "1")
    assert code == 1
    assert "stopped because 20 of 20 runs failed (20 × licence)" in said
    assert "the server is down" in said
    assert "Traceback" not in said
    assert calls(tmp_path) == 22  # one is the synthetic observation, and one was begun meanwhile
    assert not (folder / "summary.json").exists()
    (tmp_path / "licence").touch()
    main(["retry", str(folder), "--kind", "failed", "--quiet"])
    assert json.loads((folder / "summary.json").read_text())["runs"]["ok"] == 32


def test_abort_ends_the_study_at_the_first_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], without_report: None
) -> None:
    folder = study(tmp_path, monkeypatch, name="strict", above=450.0, failures={"kinds": {"licence": "abort"}})
    code, said = refused(capsys, "run", str(folder), "--quiet", "--workers", "1")
    assert code == 1
    assert "a run ended with licence" in said
    assert "E = " in said
    (tmp_path / "licence").touch()
    main(["run", str(folder), "--quiet"])
    assert json.loads((folder / "summary.json").read_text())["runs"]["ok"] == 32


@pytest.mark.parametrize(
    ("failures", "told"),
    [
        ({"kinds": {"timeout": "recover"}}, "continue, abort, or {retry: N}"),
        ({"kinds": {"timeout": {"retry": 0}}}, "continue, abort, or {retry: N}"),
        ({"kinds": {"timeout": {"retry": 1, "wait": 2}}}, "continue, abort, or {retry: N}"),
        ({"stop": "always"}, "never, or {share: 0.95, after: 20}"),
        ({"stop": {"share": 0}}, "greater than 0"),
        ({"stop": {"shares": 0.5}}, "Did you mean share?"),
        ({"kind": {}}, "Did you mean kinds?"),
    ],
    ids=str,
)
def test_wrong_policies_get_one_clear_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], failures: dict[str, Any], told: str
) -> None:
    folder = write_study(tmp_path / "study", failures=failures)
    code, said = refused(capsys, "run", str(folder))
    assert (code, said.count("\n")) == (2, 1)
    assert told in said
    assert [path.name for path in folder.iterdir()] == ["study.yaml"]
