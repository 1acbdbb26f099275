"""The job that installs the wheel sees what is wrong with one."""

import io
import stat
import tarfile
from pathlib import Path

import pytest
import yaml
from verification.validation.installed import (
    SMALL,
    Failed,
    compare_sdist,
    compare_wheel,
    newest_with_wheels,
    require,
    small,
    tracked,
)
from verification.validation.interpreters import Interpreter, find_interpreters

from strandline.studies.keys import StudyFile
from strandline.studies.template import write_template

PACKAGE = {f"src/strandline/{name}" for name in ("__init__.py", "py.typed", "report/style.css")}
KNOWN = {*PACKAGE, ".ci/run", "README.md"}
INFORMATION = ("METADATA", "WHEEL", "entry_points.txt", "licenses/LICENSE", "licenses/NOTICE.md")
GOOD = {name.removeprefix("src/"): b"" for name in PACKAGE} | {
    f"strandline-0.2.0.dist-info/{name}": b"" for name in INFORMATION
}


def program(path: Path, printed: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\necho {printed}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


def test_a_whole_wheel_passes() -> None:
    compare_wheel(GOOD, KNOWN)


@pytest.mark.parametrize("name", ["strandline/py.typed", "strandline/report/style.css"])
def test_a_file_missing_from_the_wheel_is_named(name: str) -> None:
    with pytest.raises(Failed, match=name):
        compare_wheel({key: value for key, value in GOOD.items() if key != name}, KNOWN)


def test_a_file_that_does_not_belong_into_the_wheel_is_named() -> None:
    with pytest.raises(Failed, match="tests/conftest"):
        compare_wheel({**GOOD, "tests/conftest.py": b""}, KNOWN)


@pytest.mark.parametrize("link", ["[guide](docs/guide.md)", "![picture](docs/figures/x.png)", "[below](#here)"])
def test_a_link_that_leads_nowhere_is_named(link: str) -> None:
    text = f"Name: strandline\n\nSee {link} and [this](https://doi.org/10.1186/s40323-022-00237-5)."
    with pytest.raises(Failed, match="links of the long description"):
        compare_wheel({**GOOD, "strandline-0.2.0.dist-info/METADATA": text.encode()}, KNOWN)


@pytest.mark.parametrize(("without", "extra"), [("README.md", ""), ("", "secrets.txt"), ("", "")])
def test_the_source_distribution_has_what_is_under_version_control(tmp_path: Path, without: str, extra: str) -> None:
    names = sorted({*KNOWN, "PKG-INFO", extra} - {without, ".ci/run", ""})
    with tarfile.open(tmp_path / "x.tar.gz", "w:gz") as archive:
        for name in names:
            archive.addfile(tarfile.TarInfo(f"strandline-0.2.0/{name}"), io.BytesIO())
    if without or extra:
        with pytest.raises(Failed, match=without or extra):
            compare_sdist(tmp_path / "x.tar.gz", KNOWN)
    else:
        compare_sdist(tmp_path / "x.tar.gz", KNOWN)


def test_the_study_of_init_is_made_small(tmp_path: Path) -> None:
    path = write_template(tmp_path / "study")
    path.write_text(small(path.read_text()))
    asked = yaml.safe_load(path.read_text())
    assert {key: asked[key] for key in SMALL} == {key: yaml.safe_load(value) for key, value in SMALL.items()}
    assert StudyFile.model_validate(asked)
    with pytest.raises(Failed, match="no design"):
        small("version: 1\n")


def test_pythons_are_found_newest_first_and_once_each(tmp_path: Path) -> None:
    home = tmp_path / "home"
    program(tmp_path / "bin" / "python3.12", "cpython 3 12 1 final")
    program(tmp_path / "bin" / "python3", "cpython 3 10 4 final")
    program(tmp_path / "bin" / "python3-config", "cpython 3 15 0 final")
    program(home / ".pyenv" / "versions" / "3.13.0" / "bin" / "python3.13", "cpython 3 13 0 final")
    program(home / ".pyenv" / "versions" / "3.12.0" / "bin" / "python3.12", "cpython 3 12 0 final")
    program(home / ".pyenv" / "versions" / "pypy" / "bin" / "python3.14", "pypy 3 14 0 final")
    program(home / ".local/share/uv/python/x/bin/python3.15", "cpython 3 15 0 alpha")
    (tmp_path / "bin" / "python3.14").write_text("not a program")
    found = find_interpreters({"PATH": str(tmp_path / "bin")}, home)
    assert [python.name for python in found] == ["3.13.0", "3.12.1"]
    named = str(home / ".pyenv" / "versions" / "3.12.0" / "bin" / "python3.12")
    assert [p.name for p in find_interpreters({"PATH": "", "STRANDLINE_PYTHONS": named}, home)] == ["3.12.0"]


def test_a_python_without_wheels_is_passed_over_and_other_errors_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pythons = [Interpreter((3, minor, 0), Path(f"python3.{minor}")) for minor in (14, 13, 12)]

    def command(*words: str | Path, folder: Path) -> str:
        require("3.14.0" not in str(words[0]), "exit code 1\nERROR: No matching distribution found for ngsolve")
        return ""

    monkeypatch.setattr("verification.validation.installed.command", command)
    line, chosen = newest_with_wheels(pythons, Path("x.whl"), tmp_path)
    assert line == "Python 3.14.0: ERROR: No matching distribution found for ngsolve"
    assert chosen == pythons[1]

    def broken(*words: str | Path, folder: Path) -> str:
        raise Failed("exit code 1\nERROR: no network")

    monkeypatch.setattr("verification.validation.installed.command", broken)
    with pytest.raises(Failed, match="no network"):
        list(newest_with_wheels(pythons, Path("x.whl"), tmp_path))


def test_the_files_of_the_package_are_under_version_control() -> None:
    known = tracked()
    assert {"src/strandline/py.typed", "pyproject.toml", "CITATION.cff"} <= known
    assert not [name for name in known if name.endswith(".pyc")]
