"""Jobs of `validation`: of the wheel, which see what is wrong with one; of a growing design; of kill -9."""

import io
import tarfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from verification.validation import installed, kill_and_resume
from verification.validation.active.cases import Case
from verification.validation.active.grow import grow
from verification.validation.installed import SMALL, Failed, compare_sdist, compare_wheel, newest_with_wheels, small
from verification.validation.interpreters import Interpreter

from strandline import Currents, Observation, Parameter, ParameterSpace, Uniform
from strandline.models.protocol import fingerprint
from strandline.runs import RunRequest, attempt, run_key
from strandline.studies.keys import StudyFile
from strandline.studies.template import write_template
from strandline.testing.models import Cantilever

PACKAGE = {f"src/strandline/{name}" for name in ("__init__.py", "py.typed", "report/style.css")}
KNOWN = {*PACKAGE, ".ci/run", "README.md"}
INFORMATION = ("METADATA", "WHEEL", "entry_points.txt", "licenses/LICENSE", "licenses/NOTICE.md")
INFORMATION = [f"strandline-0.2.0.dist-info/{name}" for name in INFORMATION]
GOOD = dict.fromkeys([*(name.removeprefix("src/") for name in PACKAGE), *INFORMATION], b"")
TEXT = "Name: strandline\n\nSee {} and [this](https://doi.org/10.1186/s40323-022-00237-5)."


def test_a_wheel_has_the_package_and_nothing_else_and_its_links_lead_somewhere():
    compare_wheel(GOOD, KNOWN)
    wrong = {name: {key: value for key, value in GOOD.items() if key != name} for name in GOOD if "dist" not in name}
    wrong["tests/conftest"] = {**GOOD, "tests/conftest.py": b""}
    for said, wheel in wrong.items():
        with pytest.raises(Failed, match=said):
            compare_wheel(wheel, KNOWN)
    for link in ("[guide](docs/guide.md)", "![picture](docs/figures/x.png)", "[below](#here)"):
        with pytest.raises(Failed, match="links of the long description"):
            compare_wheel({**GOOD, INFORMATION[0]: TEXT.format(link).encode()}, KNOWN)


def test_the_source_distribution_has_what_is_under_version_control(tmp_path):
    def compare(names):
        with tarfile.open(tmp_path / "x.tar.gz", "w:gz") as archive:
            for name in sorted(names - {".ci/run"}):
                archive.addfile(tarfile.TarInfo(f"strandline-0.2.0/{name}"), io.BytesIO())
        compare_sdist(tmp_path / "x.tar.gz", KNOWN)

    whole = {*KNOWN, "PKG-INFO"}
    compare(whole)
    for names, said in ((whole - {"README.md"}, "README.md"), (whole | {"secrets.txt"}, "secrets.txt")):
        with pytest.raises(Failed, match=said):
            compare(names)
    known = installed.tracked()
    assert {"src/strandline/py.typed", "pyproject.toml", "CITATION.cff"} <= known
    assert not [name for name in known if name.endswith(".pyc")]


def test_the_study_of_init_is_made_small(tmp_path):
    path = write_template(tmp_path / "study")
    path.write_text(small(path.read_text()))
    asked = yaml.safe_load(path.read_text())
    assert {key: asked[key] for key in SMALL} == {key: yaml.safe_load(value) for key, value in SMALL.items()}
    assert StudyFile.model_validate(asked)
    with pytest.raises(Failed, match="no design"):
        small("version: 1\n")


def test_a_python_without_wheels_is_passed_over_and_other_errors_are_not(tmp_path, monkeypatch):
    pythons = [Interpreter((3, minor, 0), Path(f"python3.{minor}")) for minor in (14, 13, 12)]

    def command(*words, folder):
        installed.require("3.14.0" not in str(words[0]), f"exit code 1\n{error}")
        return ""

    monkeypatch.setattr(installed, "command", command)
    error = "ERROR: No matching distribution found for ngsolve"
    assert [*newest_with_wheels(pythons, Path("x.whl"), tmp_path)] == [f"Python 3.14.0: {error}", pythons[1]]
    error = "ERROR: no network"
    with pytest.raises(Failed, match="no network"):
        list(newest_with_wheels(pythons, Path("x.whl"), tmp_path))


BEAM = Cantilever()
SETTINGS = {"seed": 3, "batch": 2, "sensitivities": False}


def test_batches_of_a_growing_design_follow_each_other_and_too_few_runs_are_more_of_the_first(tmp_path):
    def run(x, sensitivities):
        inputs = {"E": float(x[0]), "load": float(x[1])}
        return attempt(BEAM, RunRequest(run_key(fingerprint(BEAM), inputs), inputs), tmp_path)

    space = ParameterSpace((Parameter("E", Uniform(2e7, 8e7)), Parameter("load", Uniform(0.5, 1.5))))
    beam = Case("beam", space, (Observation(BEAM.outline(4e7, 1.0), 1e-4),), Currents(0.05), run)
    found = list(grow(beam, most=10, **SETTINGS))
    assert [one.runs for one in found] == [8, 10]
    before, after = (one.state.knowledge.x for one in found)
    np.testing.assert_array_equal(after[:8], before)
    assert len(np.unique(after, axis=0)) == 10
    seen = []

    def spoil(record):
        seen.append(record)
        return record if len(seen) > 6 else replace(record, state="failed", interfaces={})

    found = list(grow(beam, most=12, criterion="repulsion", spoil=spoil, **SETTINGS))
    assert [(one.runs, one.failed) for one in found] == [(12, 6)]


@pytest.mark.long
def test_after_kill_9_of_driver_and_workers_nothing_is_repeated_or_lost_and_the_posterior_is_the_same_to_the_bit():
    kill_and_resume.main(driver_kills=2, worker_kills=1, runs=60)
