"""Coverage of a study: files, resumption to the bit, the command, and what is refused."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from tests.study.questions.conftest import Stopped, content_of, described_in, keys_of, lines_of, stops_at

import strandline as sl
from strandline.calibration import Observer
from strandline.calibration.field_quality import FieldQuality
from strandline.cli import main
from strandline.errors import InvalidInput, InvalidStudy, NoCommonPoints
from strandline.interface import GaussianNoise, Interface
from strandline.questions.coverage import coverage
from strandline.studies.first_run import observations_of

FEWEST = "strandline.questions.coverage.study_coverage.FEWEST_REPLICATES"


@pytest.fixture(scope="module")
def answered(beam, tmp_path_factory):
    """A study with 20 replicates of its experiment."""
    folder = Path(shutil.copytree(beam.folder, tmp_path_factory.mktemp("coverage") / "beam"))
    return folder, sl.coverage(sl.load_study(folder), replicates=20)


def lines(folder):
    return lines_of(folder / "coverage.jsonl")


def test_what_it_writes(answered, beam):
    folder, found = answered
    noise = "independent errors of all coordinates, sd 3"
    content = content_of(found, 2, found.content["remarks"][0], noise, "64 runs", "coverage_ranks")
    assert (folder / "ledger.sqlite").read_bytes() == (beam.folder / "ledger.sqlite").read_bytes()
    assert (content["source"], content["seed"], content["measure"]) == ("prior", 1, "tracked_points")
    assert content["noise"][0]["in_words"] == f"{noise} µm"
    assert sum(content["sampling"][by] for by in ("importance", "smc")) == 20
    for name in ("E", "tilt"):
        item = content["inputs"][name]
        assert len(item["ranks"]) == 20
        assert item["p_value"] > 1e-3
        assert item["of_limit"] == pytest.approx(1.0, abs=0.25)
        assert [one["level"] for one in item["intervals"]] == [0.5, 0.9]
    named = {"versions": "PACKAGE", "inputs": "NAME", "noise[].drawn": "FACT", "noise[].analysed": "FACT"}
    assert described_in("coverage.md") - {"noise"} == keys_of(content, named, whole=("intervals", "regions"))


def test_what_was_stopped_goes_on_to_the_same_bits(folder, answered):
    """After a kill the last line may not be complete; lines of others are left alone."""
    others, known, file = ["not JSON", "[1]", '{"of": "another"}'], lines(folder), folder / "coverage.jsonl"
    file.write_text("\n".join([*others, ""]))
    (folder / "coverage.json").unlink()
    with pytest.raises(Stopped):
        coverage(sl.load_study(folder), replicates=20, observer=stops_at(4))
    assert not (folder / "coverage.json").exists()
    assert len(lines(folder)) == 7
    file.write_bytes(file.read_bytes()[:-40])
    seen = []
    watch = Observer(part=lambda p: seen.append((p.finished, p.reused)))
    coverage(sl.load_study(folder), replicates=20, observer=watch)
    assert seen == [(k, 3) for k in range(4, 21)]
    assert lines(folder) == [*others, *known]
    for name in ("coverage.json", "coverage.html"):
        assert (folder / name).read_bytes() == (answered[0] / name).read_bytes()


def test_more_replicates_add_to_those_that_are_known_and_others_are_not_mixed(folder, monkeypatch):
    study, known, first = sl.load_study(folder), lines(folder), (folder / "coverage.json").read_bytes()
    coverage(study, replicates=22)
    assert lines(folder)[:20] == known
    assert len(lines(folder)) == 22
    longer = {"": Interface.polyline(1.01 * observations_of(study)[""].points)}
    noisier = replace(study, noise=GaussianNoise(0.004**2))
    for other, seed in ((noisier, 1), (replace(study, truth=None, observed=longer), 1), (study, 2)):
        with pytest.raises(Stopped):
            coverage(other, replicates=20, seed=seed, observer=stops_at(1))
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
    assert (folder / "coverage.json").read_bytes() == first


def test_stated_errors_of_two_conditions(two_loads, copy_of, monkeypatch):
    folder = copy_of(two_loads)
    monkeypatch.setattr(FEWEST, 6)
    content = coverage(sl.load_study(folder), replicates=6).content
    assert [one["condition"] for one in content["noise"]] == ["light", "heavy"]
    assert all(one["stated"] and one["drawn"]["shift_sd"] == pytest.approx(0.01) for one in content["noise"])
    assert content["inputs"]["E"]["p_value"] > 1e-3
    page = " ".join((folder / "coverage.html").read_text("utf-8").split())
    assert "light: errors of the points as study.yaml states them, sd 8" in page


def test_the_command_prints_what_it_writes(folder, capsys):
    main(["coverage", str(folder), "--replicates", "21"])
    shown = capsys.readouterr()
    content = json.loads((folder / "coverage.json").read_text("utf-8"))
    assert shown.err.splitlines() == ["surrogate …", "replicates …", "  21 of 21", "figures and report …"]
    page = f"page: {folder / 'coverage.html'}"
    for words in ("beam: 21 replicates, truths from the prior", *content["remarks"], page):
        assert words in shown.out
    for name, item in content["inputs"].items():
        row = next(line for line in shown.out.splitlines() if line.split()[:1] == [name])
        assert f"{item['z_sd']:.2f}" in row
        assert f"{item['intervals'][1]['found']:.1%}" in row
    main(["coverage", str(folder), "--replicates", "21", "--measure", "tracked_points", "--quiet"])
    again = capsys.readouterr()
    assert (again.err, again.out) == ("", shown.out)


def test_a_coarse_surrogate_no_posterior_and_runs_without_common_points_are_refused(folder, monkeypatch):
    coarse = FieldQuality(hidden=0.001, median=0.002, q95=0.004, left_out=0.003, beyond=0.62)
    with monkeypatch.context() as patch:
        patch.setattr("strandline.questions.coverage.study_coverage.field_quality", lambda source: coarse)
        for source, remedy in (("prior", "--from posterior"), ("posterior", "an active design")):
            words = (
                f"over the {source}: got errors above 0.5 µm at 62 % of the draws .median 2 µm; at left-out runs 3 µm.;"
                f" expected at most 5 %, since the local noise hides shifts of 1 µm only. .*{remedy}"
            )
            with pytest.raises(InvalidInput, match=words):
                coverage(sl.load_study(folder), source=source)
    (folder / "posterior.nc").unlink()
    with pytest.raises(InvalidStudy, match="the study has no posterior to draw from"):
        coverage(sl.load_study(folder), source="posterior")

    def refuse(*given):
        raise NoCommonPoints("interfaces", value="open and closed ones", expected="alike", remedy="None.")

    monkeypatch.setattr("strandline.questions.knowledge.known_field", refuse)
    with pytest.raises(InvalidStudy, match="coverage needs a surrogate of the interface: got open and closed ones"):
        coverage(sl.load_study(folder))
