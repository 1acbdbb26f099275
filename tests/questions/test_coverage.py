"""Coverage of a study: files, resumption to the bit, the command, and what is refused."""

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock
from tests.questions.pages import Check, described_in, keys_of

import strandline as sl
from strandline.calibration import Observer
from strandline.calibration.experiment import CoordinateErrors
from strandline.calibration.field_quality import FieldQuality
from strandline.cli import main
from strandline.discrepancy import NormalOffset
from strandline.errors import InvalidInput, InvalidStudy, NoCommonPoints
from strandline.interface import GaussianNoise, Interface, PointErrors
from strandline.questions.coverage import coverage
from strandline.questions.knowledge import _thinned
from strandline.runs import Ledger, Progress
from strandline.studies.first_run import observations_of
from strandline.testing.studies import TWO_LOADS_STUDY, write_study

SMALL = {"sampler": {"smc": {"particles": 2000, "rejuvenation_steps": 4}}}
FILES = ("coverage.json", "coverage.html", "coverage.jsonl")


@pytest.fixture(autouse=True)
def few_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin with fewer draws of the prior."""
    monkeypatch.setattr("strandline.calibration.source.POINTS", 512)


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished study that learns the log-likelihood."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
        folder = write_study(tmp_path_factory.mktemp("coverage") / "beam", **SMALL)
        sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    return folder


def bits(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in FILES}


def lines(folder: Path) -> list[str]:
    return (folder / "coverage.jsonl").read_text("utf-8").splitlines()


def runs_in(folder: Path) -> int:
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        return ledger.counts().total


def test_what_it_writes(folder: Path) -> None:
    before = runs_in(folder)
    found = sl.coverage(sl.load_study(folder), replicates=20)
    content = json.loads((folder / "coverage.json").read_text("utf-8"))
    assert content == json.loads(json.dumps(found.content))
    assert found.page == folder / "coverage.html"
    assert runs_in(folder) == before
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
    assert pictures == ["coverage_intervals.pdf", "coverage_intervals.png", "coverage_ranks.pdf", "coverage_ranks.png"]
    assert repr(found).startswith("<StudyCoverage of beam: Nothing speaks against the posterior, but 20 ")


class Stopped(Exception):
    """The command is stopped."""


def test_what_was_stopped_goes_on_to_the_same_bits(folder: Path, tmp_path: Path) -> None:
    """After a kill the last line may not be complete."""
    whole = tmp_path / "whole" / "beam"
    shutil.copytree(folder, whole)
    coverage(sl.load_study(whole), replicates=20)

    def stop(progress: Progress) -> None:
        if progress.finished == 7:
            raise Stopped

    with pytest.raises(Stopped):
        coverage(sl.load_study(folder), replicates=20, observer=Observer(part=stop))
    assert not (folder / "coverage.json").exists()
    assert len(lines(folder)) == 7
    text = (folder / "coverage.jsonl").read_bytes()
    (folder / "coverage.jsonl").write_bytes(text[:-40])
    seen: list[tuple[int, int]] = []
    coverage(
        sl.load_study(folder), replicates=20, observer=Observer(part=lambda p: seen.append((p.finished, p.reused)))
    )
    assert seen == [(k, 6) for k in range(7, 21)]
    assert bits(folder) == bits(whole)


def test_more_replicates_add_to_those_that_are_known(folder: Path) -> None:
    coverage(sl.load_study(folder), replicates=20)
    first = lines(folder)
    coverage(sl.load_study(folder), replicates=23)
    assert lines(folder)[:20] == first
    assert len(lines(folder)) == 23


def test_other_configurations_are_not_mixed(folder: Path) -> None:
    study = sl.load_study(folder)
    coverage(study, replicates=20)
    first = bits(folder)
    others: list[dict[str, Any]] = [{"seed": 2}, {"source": "posterior"}]
    for one in others:
        coverage(study, replicates=20, **one)
    coverage(dataclasses.replace(study, noise=GaussianNoise(0.004**2)), replicates=20)
    seen = observations_of(study)[""]
    longer = dataclasses.replace(study, truth=None, observed={"": Interface.polyline(1.01 * seen.points)})
    coverage(longer, replicates=20)
    assert len(lines(folder)) == 100
    assert len({json.loads(line)["of"] for line in lines(folder)}) == 5
    coverage(study, replicates=20)
    assert len(lines(folder)) == 100
    assert (folder / "coverage.json").read_bytes() == first["coverage.json"]


def test_two_at_once_do_not_mix(folder: Path) -> None:
    with FileLock(folder / "coverage.jsonl.lock"), pytest.raises(InvalidStudy, match="one at a time"):
        coverage(sl.load_study(folder), replicates=21)
    assert not any((folder / name).exists() for name in FILES)


def test_lines_of_others_are_left_alone(folder: Path) -> None:
    (folder / "coverage.jsonl").write_text('not JSON\n[1]\n{"of": "another"}\n')
    coverage(sl.load_study(folder), replicates=20)
    assert lines(folder)[:3] == ["not JSON", "[1]", '{"of": "another"}']
    assert len(lines(folder)) == 23


def test_truths_from_the_posterior(folder: Path) -> None:
    content = coverage(sl.load_study(folder), replicates=20, source="posterior").content
    assert content["source"] == "posterior"
    assert min(item["p_value"] for item in content["inputs"].values()) > 1e-3
    assert "with the posterior of the real observation as its prior" in (folder / "coverage.html").read_text("utf-8")


def test_stated_errors_of_two_conditions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
    noise = {"sd": 8, "unit": "um", "unknown": {"shift": 10, "shared": True}}
    changes = {**TWO_LOADS_STUDY, **SMALL, "noise": noise, "discrepancy": {"normal_offset": {}}}
    folder = write_study(tmp_path / "two", **{**changes, "surrogate": {"field": {}}})
    sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    content = coverage(sl.load_study(folder), replicates=20).content
    assert [one["condition"] for one in content["noise"]] == ["light", "heavy"]
    assert all(one["stated"] and one["drawn"]["shift_sd"] == pytest.approx(0.01) for one in content["noise"])
    assert content["inputs"]["E"]["p_value"] > 1e-3
    assert "light: errors of the points as study.yaml states them, sd 8" in " ".join(
        (folder / "coverage.html").read_text("utf-8").split()
    )


def test_a_study_whose_noise_is_wrong_is_found_out(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: three times the errors that the analysis assumes."""
    monkeypatch.setattr("strandline.calibration.experiment.errors_behind", lambda *given: CoordinateErrors(0.009))
    content = coverage(sl.load_study(folder), replicates=30).content
    assert not content["calibrated"]
    assert content["remarks"][0].startswith("The posterior is too narrow: ")


def test_every_key_is_described(folder: Path) -> None:
    found = coverage(sl.load_study(folder), replicates=20).content
    named = {"versions": "PACKAGE", "inputs": "NAME", "noise[].drawn": "FACT", "noise[].analysed": "FACT"}
    assert described_in("coverage.md") - {"noise"} == keys_of(found, named, whole=("intervals", "regions"))


class TestCommand:
    def test_it_prints_what_it_writes(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        main(["coverage", str(folder), "--replicates", "20"])
        shown = capsys.readouterr()
        content = json.loads((folder / "coverage.json").read_text("utf-8"))
        assert shown.err.splitlines() == ["surrogate …", "replicates …", "  20 of 20", "figures and report …"]
        assert "beam: 20 replicates, truths from the prior" in shown.out
        for remark in content["remarks"]:
            assert remark in shown.out
        for name, item in content["inputs"].items():
            row = next(line for line in shown.out.splitlines() if line.split()[:1] == [name])
            assert f"{item['z_sd']:.2f}" in row
            assert f"{item['intervals'][1]['found']:.1%}" in row
        assert f"page: {folder / 'coverage.html'}" in shown.out
        main(["coverage", str(folder), "--replicates", "20", "--measure", "tracked_points", "--quiet"])
        again = capsys.readouterr()
        assert again.err == ""
        assert again.out == shown.out

    def test_the_doctor_notices_another_study(
        self, folder: Path, noticed_by_doctor: Callable[[str, str], None]
    ) -> None:
        coverage(sl.load_study(folder), replicates=20)
        noticed_by_doctor("coverage.json", "strandline coverage")


REFUSED: list[tuple[list[str], str | None, str]] = [
    (["--replicates", "19"], None, "replicates of the coverage: got 19; expected at least 20"),
    (["--measure", "currents"], None, "measure of the coverage: got currents; expected one of the study's: tracked_"),
    (["--seed", "-1"], None, "--seed"),
    (["--from", "somewhere"], None, "--from"),
    ([], "ledger.sqlite", "the study is not finished: got 0 of 65 forward runs done"),
    (["--from", "posterior"], "posterior.nc", "the study has no posterior to draw from"),
]


@pytest.mark.parametrize(("options", "without", "words"), REFUSED)
def test_what_is_refused(options: list[str], without: str | None, words: str, folder: Path, refused: Check) -> None:
    if without is not None:
        (folder / without).unlink()
    refused(["coverage", str(folder), "--quiet", *options], words, folder)


@pytest.mark.parametrize(("source", "remedy"), [("prior", "--from posterior"), ("posterior", "an active design")])
def test_a_coarse_surrogate_is_refused(
    source: str, remedy: str, folder: Path, refused: Check, monkeypatch: pytest.MonkeyPatch
) -> None:
    coarse = FieldQuality(hidden=0.001, median=0.002, q95=0.004, left_out=0.003, beyond=0.62)
    monkeypatch.setattr("strandline.questions.coverage.study_coverage.field_quality", lambda source: coarse)
    words = (
        f"is not accurate enough over the {source}: got errors above 0.5 µm at 62 % of the draws (median 2 µm; at "
        "left-out runs 3 µm); expected at most 5 %, since the local noise hides shifts of 1 µm only. Make more runs"
    )
    refused(["coverage", str(folder), "--quiet", "--from", source], words, folder)
    with pytest.raises(InvalidInput, match=remedy):
        coverage(sl.load_study(folder), source=source)


def test_runs_without_common_points_are_refused(folder: Path, refused: Check, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*given: object) -> None:
        raise NoCommonPoints("interfaces", value="open and closed ones", expected="alike", remedy="None.")

    monkeypatch.setattr("strandline.questions.knowledge.known_field", refuse)
    refused(
        ["coverage", str(folder), "--quiet"],
        "coverage needs a surrogate of the interface: got open and closed ones",
        folder,
    )


def test_long_designs_are_thinned_only_if_the_log_likelihood_is_learnt(folder: Path) -> None:
    study = sl.load_study(folder)
    many = tuple(sl.RunRecord(str(k), {}, "ok") for k in range(1000))
    few = _thinned(study, many)
    assert [int(one.key) for one in few] == [*range(200), *range(800, 1000)]
    by_field = dataclasses.replace(study, settings=dataclasses.replace(study.settings, surrogate="field"))
    assert _thinned(by_field, many) == many
    assert _thinned(study, many[:400]) == many[:400]


@pytest.mark.long
def test_the_beam_is_calibrated(analysed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With all draws of the prior, and independent errors along the normals of another measure."""
    monkeypatch.undo()
    shutil.copytree(analysed, tmp_path / "beam")
    study = sl.load_study(tmp_path / "beam")
    errors = dataclasses.replace(study, noise=PointErrors(0.003), discrepancies={"offset": NormalOffset()})
    for one in (study, errors):
        content = coverage(one, replicates=200).content
        assert min(item["p_value"] for item in content["inputs"].values()) > 1e-3
        assert all(0.85 < item["z_sd"] < 1.18 for item in content["inputs"].values())
