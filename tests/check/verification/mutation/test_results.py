"""Results are kept for as long as the text of their file stays."""

import json
from pathlib import Path

import pytest
from verification.mutation.results import Result, fingerprint, known_results, name_of, record, table

from verification.mutation import results


def result(package: Path, file: str, start: int, end: str) -> dict[str, str]:
    texts = {"file": file, "text": fingerprint(package / file), "line": "1", "start": str(start)}
    return {**texts, "before": 'x, "β"', "after": "(x)", "end": end, "test": "", "seconds": "3"}


def package(folder: Path) -> Path:
    (folder / "smc").mkdir()
    (folder / "smc" / "moves.py").write_text("x = 1\n", "utf-8")
    (folder / "smc" / "steps.py").write_text("x = 1\n", "utf-8")
    return folder


def test_what_is_recorded_is_read_again_and_later_results_replace_it(tmp_path: Path) -> None:
    place, recorded, kept = package(tmp_path), tmp_path / "recorded.csv", tmp_path / "kept.jsonl"
    assert known_results(place, recorded, kept) == {}
    first, second = result(place, "smc/moves.py", 30, "passed"), result(place, "smc/moves.py", 4, "failed")
    record([first, second], recorded)
    assert [row["start"] for row in known_results(place, recorded, kept).values()] == ["4", "30"]
    kept.write_text(json.dumps({**first, "end": "failed"}) + "\n", "utf-8")
    found: dict[tuple[str, ...], Result] = known_results(place, recorded, kept)
    assert len(found) == 2
    assert found[name_of(first)]["end"] == "failed"


def test_results_of_a_file_are_forgotten_when_its_text_changes(tmp_path: Path) -> None:
    place, recorded = package(tmp_path), tmp_path / "recorded.csv"
    record([result(place, file, 4, "failed") for file in ("smc/moves.py", "smc/steps.py")], recorded)
    (tmp_path / "smc" / "moves.py").write_text("x = 2\n", "utf-8")
    found = known_results(place, recorded, tmp_path / "none.jsonl")
    assert [row["file"] for row in found.values()] == ["smc/steps.py"]
    (tmp_path / "smc" / "steps.py").unlink()
    assert known_results(place, recorded, tmp_path / "none.jsonl") == {}


def test_a_table_counts_what_was_noticed(tmp_path: Path) -> None:
    place = package(tmp_path)
    rows = [
        result(place, "smc/moves.py", k, end) for k, end in enumerate(["failed", "hung", "broke", "passed", "unsure"])
    ]
    found = {row[0]: row[1:] for row in table(rows).rows}
    assert found["sampler"] == found["all"] == (5, 3, 0, 2)
    assert found["posterior"] == (0, 0, 0, 0)


def test_an_explanation_holds_for_the_lines_that_it_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "PACKAGE", package(tmp_path))
    monkeypatch.setattr(results, "EXPLAINED", {("smc/moves.py", "1", "(3)"): "everywhere"})
    monkeypatch.setattr(results, "EXPLAINED_ON_LINE", {("smc/moves.py", "x = 1", "1", "(2)"): "there"})
    (tmp_path / "smc" / "moves.py").write_text("x = 1\ny = 1\n", "utf-8")
    found = {
        (line, after): results.explained({"file": "smc/moves.py", "line": line, "before": "1", "after": after})
        for line in "12"
        for after in ("(2)", "(3)", "(4)")
    }
    assert [place for place, is_explained in found.items() if is_explained] == [
        ("1", "(2)"),
        ("1", "(3)"),
        ("2", "(3)"),
    ]
