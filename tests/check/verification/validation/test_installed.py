"""Jobs of `validation`: of the wheel, which see what is wrong with one, and of kill -9."""

import io
import tarfile

import pytest
from verification.validation import installed, kill_and_resume
from verification.validation.installed import Failed, compare_sdist, compare_wheel

PACKAGE = {f"src/strandline/{name}" for name in ("__init__.py", "py.typed", "report/style.css")}
KNOWN = {*PACKAGE, ".ci/run", "README.md"}
INFORMATION = ("METADATA", "WHEEL", "entry_points.txt", "licenses/LICENSE", "licenses/NOTICE.md")
INFORMATION = [f"strandline-0.3.0.dist-info/{name}" for name in INFORMATION]
GOOD = dict.fromkeys([*(name.removeprefix("src/") for name in PACKAGE), *INFORMATION], b"")


def test_a_wheel_has_the_package_and_nothing_else_and_its_links_lead_somewhere():
    compare_wheel(GOOD, KNOWN)
    wrong = {name: {key: value for key, value in GOOD.items() if key != name} for name in GOOD if "dist" not in name}
    wrong["tests/conftest"] = {**GOOD, "tests/conftest.py": b""}
    for said, wheel in wrong.items():
        with pytest.raises(Failed, match=said):
            compare_wheel(wheel, KNOWN)
    with pytest.raises(Failed, match="links of the long description"):
        compare_wheel({**GOOD, INFORMATION[0]: b"Name: strandline\n\nSee [guide](docs/guide.md)."}, KNOWN)


def test_the_source_distribution_has_what_is_under_version_control(tmp_path):
    def compare(names):
        with tarfile.open(tmp_path / "x.tar.gz", "w:gz") as archive:
            for name in sorted(names - {".ci/run"}):
                archive.addfile(tarfile.TarInfo(f"strandline-0.3.0/{name}"), io.BytesIO())
        compare_sdist(tmp_path / "x.tar.gz", KNOWN)

    whole = {*KNOWN, "PKG-INFO"}
    compare(whole)
    for names, said in ((whole - {"README.md"}, "README.md"), (whole | {"secrets.txt"}, "secrets.txt")):
        with pytest.raises(Failed, match=said):
            compare(names)
    assert {"src/strandline/py.typed", "pyproject.toml", "CITATION.cff"} <= installed.tracked()


@pytest.mark.long
def test_after_kill_9_nothing_is_repeated_or_lost_and_the_posterior_is_the_same_to_the_bit():
    kill_and_resume.main(drivers=2, workers=1, simulators=1, runs=60)
