"""Copies of finished studies for the questions about them, and what the doctor says of an answer."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.study.conftest import Finished, Share

from strandline.studies import load_study
from strandline.studies.doctor import examine
from strandline.testing.studies import TWO_LOADS_STUDY

NoticedByDoctor = Callable[[Path, str, str], None]


@pytest.fixture(scope="session")
def two_loads(share: Share) -> Finished:
    """A beam under two loads, whose pictures share an unknown shift."""
    content = {key: value for key, value in TWO_LOADS_STUDY.items() if key != "name"}
    noise = {"sd": 8, "unit": "um", "unknown": {"shift": 10, "shared": True}}
    parts = {"discrepancy": {"normal_offset": {}}, "surrogate": {"field": {}}, "noise": noise}
    return share("two-loads", **{**content, **parts, "report": "none"})


def line_by_line(finished: Finished, folder: Path) -> Path:
    """Copy a finished study, whose study.yaml then has a key a line, as a user writes it; its results stay current."""
    shutil.copytree(finished.folder, folder)
    content = json.loads((folder / "study.yaml").read_text("utf-8"))
    (folder / "study.yaml").write_text("".join(f"{key}: {json.dumps(value)}\n" for key, value in content.items()))
    text = (folder / "summary.json").read_text("utf-8")
    new = load_study(folder).text_digest
    (folder / "summary.json").write_text(text.replace(finished.study.text_digest, new), "utf-8")
    return folder


@pytest.fixture
def noticed_by_doctor() -> NoticedByDoctor:
    """Check that the doctor notices an answer of another study, and names the command that makes it anew."""

    def check(folder: Path, file: str, command: str) -> None:
        assert not [one for one in examine(folder) if file in one.what]
        text = (folder / file).read_text("utf-8")
        (folder / file).write_text(json.dumps({**json.loads(text), "study_sha256": "another"}))
        (found,) = [one for one in examine(folder) if file in one.what]
        assert command in found.remedy
        (folder / file).write_text(text)

    return check
