"""The job that installs the wheel sees what is wrong with one."""

import io
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
OF_WHEEL = "strandline-0.2.0.dist-info"
INFORMATION = [f"{OF_WHEEL}/{name}" for name in ("METADATA", "WHEEL", "entry_points.txt")]
INFORMATION += [f"{OF_WHEEL}/licenses/{name}" for name in ("LICENSE", "NOTICE.md")]
GOOD = dict.fromkeys([*(name.removeprefix("src/") for name in PACKAGE), *INFORMATION], b"")
TEXT = "Name: strandline\n\nSee {} and [this](https://doi.org/10.1186/s40323-022-00237-5)."
LINKS = ("[guide](docs/guide.md)", "![picture](docs/figures/x.png)", "[below](#here)")
WRONG = [
    ({key: value for key, value in GOOD.items() if key != "strandline/py.typed"}, "strandline/py.typed"),
    ({key: value for key, value in GOOD.items() if not key.endswith(".css")}, "strandline/report/style.css"),
    ({**GOOD, "tests/conftest.py": b""}, "tests/conftest"),
    *(({**GOOD, INFORMATION[0]: TEXT.format(link).encode()}, "links of the long description") for link in LINKS),
]


def test_a_wheel_has_the_package_and_nothing_else_and_its_links_lead_somewhere() -> None:
    compare_wheel(GOOD, KNOWN)
    for wheel, said in WRONG:
        with pytest.raises(Failed, match=said):
            compare_wheel(wheel, KNOWN)


def test_the_source_distribution_has_what_is_under_version_control(tmp_path: Path) -> None:
    def archived(names: set[str]) -> Path:
        with tarfile.open(tmp_path / "x.tar.gz", "w:gz") as archive:
            for name in sorted(names - {".ci/run"}):
                archive.addfile(tarfile.TarInfo(f"strandline-0.2.0/{name}"), io.BytesIO())
        return tmp_path / "x.tar.gz"

    whole = {*KNOWN, "PKG-INFO"}
    compare_sdist(archived(whole), KNOWN)
    for names, said in ((whole - {"README.md"}, "README.md"), (whole | {"secrets.txt"}, "secrets.txt")):
        with pytest.raises(Failed, match=said):
            compare_sdist(archived(names), KNOWN)
    known = tracked()
    assert {"src/strandline/py.typed", "pyproject.toml", "CITATION.cff"} <= known
    assert not [name for name in known if name.endswith(".pyc")]


def test_the_study_of_init_is_made_small(tmp_path: Path) -> None:
    path = write_template(tmp_path / "study")
    path.write_text(small(path.read_text()))
    asked = yaml.safe_load(path.read_text())
    assert {key: asked[key] for key in SMALL} == {key: yaml.safe_load(value) for key, value in SMALL.items()}
    assert StudyFile.model_validate(asked)
    with pytest.raises(Failed, match="no design"):
        small("version: 1\n")


def test_pythons_are_found_newest_first_and_once_each(tmp_path: Path) -> None:
    home, versions = tmp_path / "home", "home/.pyenv/versions"
    for name, printed in {
        "bin/python3.12": "cpython 3 12 1 final",
        "bin/python3": "cpython 3 10 4 final",
        "bin/python3-config": "cpython 3 15 0 final",
        f"{versions}/3.13.0/bin/python3.13": "cpython 3 13 0 final",
        f"{versions}/3.12.0/bin/python3.12": "cpython 3 12 0 final",
        f"{versions}/pypy/bin/python3.14": "pypy 3 14 0 final",
        "home/.local/share/uv/python/x/bin/python3.15": "cpython 3 15 0 alpha",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"#!/bin/sh\necho {printed}\n")
        (tmp_path / name).chmod(0o755)
    (tmp_path / "bin" / "python3.14").write_text("not a program")
    found = find_interpreters({"PATH": str(tmp_path / "bin")}, home)
    assert [python.name for python in found] == ["3.13.0", "3.12.1"]
    named = str(tmp_path / versions / "3.12.0" / "bin" / "python3.12")
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
