"""Copies of finished studies for the questions about them, what an answer leaves in a folder, and how it is stopped."""

import json
import shutil
from pathlib import Path

import pytest

from strandline.calibration import Observer
from strandline.studies import load_study
from strandline.testing.studies import TWO_LOADS_STUDY

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="session")
def two_loads(share):
    """A beam under two loads, whose pictures share an unknown shift."""
    content = {key: value for key, value in TWO_LOADS_STUDY.items() if key != "name"}
    noise = {"sd": 8, "unit": "um", "unknown": {"shift": 10, "shared": True}}
    parts = {"discrepancy": {"normal_offset": {}}, "surrogate": {"field": {}}, "noise": noise}
    return share("two-loads", **{**content, **parts, "report": "none"})


@pytest.fixture
def folder(answered, tmp_path):
    """A copy of the answered study of a file of tests, which the test may change."""
    return Path(shutil.copytree(answered[0], tmp_path / "beam"))


def line_by_line(finished, folder):
    """Copy a finished study, whose study.yaml then has a key a line, as a user writes it; its results stay current."""
    finished.copied(folder)
    content = json.loads((folder / "study.yaml").read_text("utf-8"))
    (folder / "study.yaml").write_text("".join(f"{key}: {json.dumps(value)}\n" for key, value in content.items()))
    text = (folder / "summary.json").read_text("utf-8")
    new = load_study(folder).text_digest
    (folder / "summary.json").write_text(text.replace(finished.study.text_digest, new), "utf-8")
    return folder


def content_of(found, pictures, *words):
    """Return the content of an answer's file, which docs/reference describes; its page needs no script."""
    folder, content = found.page.parent, json.loads(found.page.with_suffix(".json").read_text("utf-8"))
    assert content == json.loads(json.dumps(found.content))
    page = (ROOT / "docs" / "reference" / "files.md").read_text("utf-8")
    everywhere, (answers, *sections) = page.partition("\n## ")[0], page.partition("\n## Answers\n")[2].split("\n### ")
    described = everywhere + answers + next(one for one in sections if one.startswith(f"{found.page.stem}.json\n"))
    assert [key for key in content if f"`{key}" not in described] == []
    if "study_sha256" in content:
        assert content["study_sha256"] == load_study(folder).text_digest
    assert len([*(folder / "figures").glob(f"{found.page.stem.replace('-', '_')}*.png")]) == pictures
    page = found.page.read_text("utf-8")
    assert [one for one in words if one not in page] == []
    assert "<script" not in page
    assert page.count("<img ") == page.count('src="data:image/png') == pictures
    return content


def lines_of(file):
    return file.read_text("utf-8").splitlines()


class Stopped(Exception):
    """The command is stopped."""


def stops_at(number):
    """Return an observer that stops the command as soon as so many parts are finished."""

    def part(progress):
        if progress.finished >= number:
            raise Stopped

    return Observer(part=part)
