"""Results are kept for as long as the text of their file stays."""

import json
from pathlib import Path

import pytest
from verification.mutation.results import Result, explained, fingerprint, known_results, name_of, record, table

MOVES, STEPS = "smc/moves.py", "smc/deep/steps.py"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    for name in (MOVES, STEPS):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x = 1\ny = 1\n", "utf-8")
    return tmp_path


def result(package: Path, file: str, start: int, end: str) -> dict[str, str]:
    texts = {"file": file, "text": fingerprint(package / file), "line": "1", "start": str(start)}
    return {**texts, "before": 'x, "β"', "after": "(x)", "end": end, "test": "", "seconds": "3"}


def test_what_is_recorded_is_read_again_until_the_text_of_its_file_changes(package: Path) -> None:
    recorded, kept = package / "recorded.csv", package / "kept.jsonl"
    assert known_results(package, recorded, kept) == {}
    first, second = result(package, MOVES, 30, "passed"), result(package, MOVES, 4, "failed")
    record([first, second, result(package, STEPS, 4, "failed")], recorded)
    assert [row["start"] for row in known_results(package, recorded, kept).values()] == ["4", "4", "30"]
    kept.write_text(json.dumps({**first, "end": "failed"}) + "\n", "utf-8")
    found: dict[tuple[str, ...], Result] = known_results(package, recorded, kept)
    assert len(found) == 3
    assert found[name_of(first)]["end"] == "failed"
    (package / MOVES).write_text("x = 2\n", "utf-8")
    assert [row["file"] for row in known_results(package, recorded, kept).values()] == [STEPS]
    (package / STEPS).unlink()
    assert known_results(package, recorded, kept) == {}


def test_a_table_counts_what_was_noticed_in_rooms_within_rooms_too(package: Path) -> None:
    ends = ["failed", "hung", "broke", "passed", "unsure"]
    rows = [result(package, STEPS if k < 3 else MOVES, k, end) for k, end in enumerate(ends)]
    found = {row[0]: row[1:] for row in table(rows).rows}
    assert found["sampler"] == found["all"] == (5, 3, 0, 2)
    assert found["posterior"] == (0, 0, 0, 0)


def test_an_explanation_holds_for_the_lines_that_it_names(package: Path) -> None:
    known = {"anywhere": {(MOVES, "1", "(3)")}, "on_line": [(MOVES, "x = 1", "1", "(2)")]}
    found = [
        (line, after)
        for line in "12"
        for after in ("(2)", "(3)", "(4)")
        if explained({"file": MOVES, "line": line, "before": "1", "after": after}, package=package, **known)  # type: ignore[arg-type]
    ]
    assert found == [("1", "(2)"), ("1", "(3)"), ("2", "(3)")]
