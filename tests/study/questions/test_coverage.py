"""Coverage of a study: files, resumption to the bit, the command, and what is refused."""

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.study.conftest import Finished
from tests.study.questions.conftest import NoticedByDoctor
from tests.study.questions.pages import described_in, keys_of
from tests.unit.cli.command_line import Shown

import strandline as sl
from strandline.calibration import Observer
from strandline.calibration.experiment import CoordinateErrors
from strandline.calibration.field_quality import FieldQuality
from strandline.cli import main
from strandline.errors import InvalidInput, InvalidStudy, NoCommonPoints
from strandline.interface import GaussianNoise, Interface
from strandline.questions.coverage import StudyCoverage, coverage
from strandline.runs import Progress
from strandline.studies.first_run import observations_of

Copy = Callable[[Finished], Path]
FEWEST = "strandline.questions.coverage.study_coverage.FEWEST_REPLICATES"
FILES = ("coverage.json", "coverage.html", "coverage.jsonl")


@pytest.fixture(scope="module")
def answered(beam: Finished, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, StudyCoverage]:
    """A study with 20 replicates of its experiment."""
    folder = Path(shutil.copytree(beam.folder, tmp_path_factory.mktemp("coverage") / "beam"))
    return folder, sl.coverage(sl.load_study(folder), replicates=20)


@pytest.fixture
def folder(answered: tuple[Path, StudyCoverage], tmp_path: Path) -> Path:
    """A copy of that study, which the test may change."""
    return Path(shutil.copytree(answered[0], tmp_path / "beam"))


def bits(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in FILES}


def lines(folder: Path) -> list[str]:
    return (folder / "coverage.jsonl").read_text("utf-8").splitlines()


def test_what_it_writes(
    answered: tuple[Path, StudyCoverage], beam: Finished, noticed_by_doctor: NoticedByDoctor
) -> None:
    folder, found = answered
    content = json.loads((folder / "coverage.json").read_text("utf-8"))
    assert content == json.loads(json.dumps(found.content))
    assert found.page == folder / "coverage.html"
    assert (folder / "ledger.sqlite").read_bytes() == (beam.folder / "ledger.sqlite").read_bytes()
    assert (content["source"], content["seed"], content["replicates"]) == ("prior", 1, 20)
    assert content["measure"] == "tracked_points"
    assert content["noise"][0]["in_words"] == "independent errors of all coordinates, sd 3 µm"
    assert content["surrogate"]["runs"] == 64
    assert sum(content["sampling"][by] for by in ("importance", "smc")) == 20
    for name in ("E", "tilt"):
        item = content["inputs"][name]
        assert len(item["ranks"]) == 20
        assert item["p_value"] > 1e-3
        assert item["of_limit"] == pytest.approx(1.0, abs=0.25)
        assert [one["level"] for one in item["intervals"]] == [0.5, 0.9]
    page = found.page.read_text("utf-8")
    for words in (content["remarks"][0], "independent errors of all coordinates, sd 3", "64 runs", "coverage_ranks"):
        assert words in page
    assert "<script" not in page
    assert page.count("<img ") == page.count('src="data:image/png') == 2
    pictures = sorted(path.name for path in (folder / "figures").glob("coverage*"))
    assert pictures == ["coverage_intervals.png", "coverage_ranks.png"]
    assert repr(found).startswith("<StudyCoverage of beam: Nothing speaks against the posterior, but 20 ")
    named = {"versions": "PACKAGE", "inputs": "NAME", "noise[].drawn": "FACT", "noise[].analysed": "FACT"}
    assert described_in("coverage.md") - {"noise"} == keys_of(found.content, named, whole=("intervals", "regions"))
    noticed_by_doctor(folder, "coverage.json", "strandline coverage")


class Stopped(Exception):
    """The command is stopped."""


def test_what_was_stopped_goes_on_to_the_same_bits(folder: Path, answered: tuple[Path, StudyCoverage]) -> None:
    """After a kill the last line may not be complete; lines of others are left alone."""
    others = ["not JSON", "[1]", '{"of": "another"}']
    (folder / "coverage.jsonl").write_text("\n".join([*others, ""]))
    (folder / "coverage.json").unlink()

    def stop(progress: Progress) -> None:
        if progress.finished == 4:
            raise Stopped

    with pytest.raises(Stopped):
        coverage(sl.load_study(folder), replicates=20, observer=Observer(part=stop))
    assert not (folder / "coverage.json").exists()
    assert len(lines(folder)) == 7
    text = (folder / "coverage.jsonl").read_bytes()
    known = lines(answered[0])
    (folder / "coverage.jsonl").write_bytes(text[:-40])
    seen: list[tuple[int, int]] = []
    watch = Observer(part=lambda p: seen.append((p.finished, p.reused)))
    coverage(sl.load_study(folder), replicates=20, observer=watch)
    assert seen == [(k, 3) for k in range(4, 21)]
    assert lines(folder) == [*others, *known]
    for name in ("coverage.json", "coverage.html"):
        assert (folder / name).read_bytes() == (answered[0] / name).read_bytes()


def test_more_replicates_add_to_those_that_are_known_and_others_are_not_mixed(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study, first = sl.load_study(folder), bits(folder)
    coverage(study, replicates=22)
    assert lines(folder)[:20] == first["coverage.jsonl"].decode().splitlines()
    assert len(lines(folder)) == 22
    seen = observations_of(study)[""]
    longer = {"truth": None, "observed": {"": Interface.polyline(1.01 * seen.points)}}
    stopping = Observer(part=lambda progress: stop())

    def stop() -> None:
        raise Stopped

    for other in (dataclasses.replace(study, noise=GaussianNoise(0.004**2)), dataclasses.replace(study, **longer)):
        with pytest.raises(Stopped):
            coverage(other, replicates=20, observer=stopping)
    with pytest.raises(Stopped):
        coverage(study, replicates=20, seed=2, observer=stopping)
    with monkeypatch.context() as patch:
        patch.setattr(FEWEST, 6)
        content = coverage(study, replicates=6, source="posterior").content
    assert content["source"] == "posterior"
    assert min(item["p_value"] for item in content["inputs"].values()) > 1e-3
    assert "with the posterior of the real observation as its prior" in (folder / "coverage.html").read_text("utf-8")
    assert len(lines(folder)) == 31
    assert len({json.loads(line)["of"] for line in lines(folder)}) == 5
    coverage(study, replicates=20)
    assert len(lines(folder)) == 31
    assert (folder / "coverage.json").read_bytes() == first["coverage.json"]


def test_stated_errors_of_two_conditions(two_loads: Finished, copy_of: Copy, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = copy_of(two_loads)
    monkeypatch.setattr(FEWEST, 6)
    content = coverage(sl.load_study(folder), replicates=6).content
    assert [one["condition"] for one in content["noise"]] == ["light", "heavy"]
    assert all(one["stated"] and one["drawn"]["shift_sd"] == pytest.approx(0.01) for one in content["noise"])
    assert content["inputs"]["E"]["p_value"] > 1e-3
    page = " ".join((folder / "coverage.html").read_text("utf-8").split())
    assert "light: errors of the points as study.yaml states them, sd 8" in page


def test_a_study_whose_noise_is_wrong_is_found_out(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: three times the errors that the analysis assumes."""
    monkeypatch.setattr("strandline.calibration.experiment.errors_behind", lambda *given: CoordinateErrors(0.009))
    content = coverage(sl.load_study(folder), replicates=30, seed=3).content
    assert not content["calibrated"]
    assert content["remarks"][0].startswith("The posterior is too narrow: ")


def test_the_command_prints_what_it_writes(folder: Path, capsys: Shown) -> None:
    main(["coverage", str(folder), "--replicates", "21"])
    shown = capsys.readouterr()
    content = json.loads((folder / "coverage.json").read_text("utf-8"))
    assert shown.err.splitlines() == ["surrogate …", "replicates …", "  21 of 21", "figures and report …"]
    assert "beam: 21 replicates, truths from the prior" in shown.out
    for remark in content["remarks"]:
        assert remark in shown.out
    for name, item in content["inputs"].items():
        row = next(line for line in shown.out.splitlines() if line.split()[:1] == [name])
        assert f"{item['z_sd']:.2f}" in row
        assert f"{item['intervals'][1]['found']:.1%}" in row
    assert f"page: {folder / 'coverage.html'}" in shown.out
    main(["coverage", str(folder), "--replicates", "21", "--measure", "tracked_points", "--quiet"])
    again = capsys.readouterr()
    assert (again.err, again.out) == ("", shown.out)


def test_a_coarse_surrogate_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    coarse = FieldQuality(hidden=0.001, median=0.002, q95=0.004, left_out=0.003, beyond=0.62)
    monkeypatch.setattr("strandline.questions.coverage.study_coverage.field_quality", lambda source: coarse)
    for source, remedy in (("prior", "--from posterior"), ("posterior", "an active design")):
        words = (
            f"over the {source}: got errors above 0.5 µm at 62 % of the draws .median 2 µm; at left-out runs 3 µm.; "
            f"expected at most 5 %, since the local noise hides shifts of 1 µm only. .*{remedy}"
        )
        with pytest.raises(InvalidInput, match=words):
            coverage(sl.load_study(folder), source=source)


def test_runs_without_common_points_or_a_posterior_are_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "posterior.nc").unlink()
    with pytest.raises(InvalidStudy, match="the study has no posterior to draw from"):
        coverage(sl.load_study(folder), source="posterior")

    def refuse(*given: object) -> None:
        raise NoCommonPoints("interfaces", value="open and closed ones", expected="alike", remedy="None.")

    monkeypatch.setattr("strandline.questions.knowledge.known_field", refuse)
    with pytest.raises(InvalidStudy, match="coverage needs a surrogate of the interface: got open and closed ones"):
        coverage(sl.load_study(folder))
