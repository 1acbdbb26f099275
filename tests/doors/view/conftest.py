"""A finished study of a beam that learns the interface, shared by the tests of its page."""

import shutil
from pathlib import Path
from typing import Any

import pytest
from tests.study.conftest import FIELD, finish

SMALL: dict[str, Any] = {**FIELD, "draft": True, "report": "none"}


@pytest.fixture(scope="session")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return finish(tmp_path_factory.mktemp("view") / "beam", **SMALL).folder


@pytest.fixture
def folder(analysed: Path, tmp_path: Path) -> Path:
    """A copy of the study, which the test may change."""
    return Path(shutil.copytree(analysed, tmp_path / "beam"))
