"""What the tests of all questions share: a copy of a finished study, and the check of a command that is refused."""

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from tests.questions.pages import Check

from strandline.cli import main
from strandline.studies.doctor import examine

HIDDEN = ("-shm", "-wal", ".lock")


@pytest.fixture
def folder(analysed: Path, tmp_path: Path) -> Path:
    """A copy of the finished study of this file, which the test may change."""
    target = tmp_path / "beam"
    shutil.copytree(analysed, target)
    return target


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Check:
    """Check that a command ends with code 2 and one line that contains some words, and writes nothing in a folder."""

    def there(where: Path) -> list[Path]:
        return sorted(path for path in where.rglob("*") if not path.name.endswith(HIDDEN))

    def check(command: Sequence[str], words: str, where: Path) -> None:
        before = there(where)
        with pytest.raises(SystemExit) as ended:
            main([*command])
        shown = capsys.readouterr()
        assert ended.value.code == 2
        assert shown.out == ""
        (line,) = shown.err.splitlines()
        assert words in line
        assert there(where) == before

    return check


@pytest.fixture
def noticed_by_doctor(folder: Path) -> Callable[[str, str], None]:
    """Check that the doctor notices a result of another study, and names the command that makes it anew."""

    def check(file: str, command: str) -> None:
        assert not [one for one in examine(folder) if file in one.what]
        content = json.loads((folder / file).read_text("utf-8"))
        (folder / file).write_text(json.dumps({**content, "study_sha256": "another"}))
        (found,) = [one for one in examine(folder) if file in one.what]
        assert command in found.remedy

    return check
