"""Coverage of a study: files, resumption to the bit, the command, and what is refused."""

import json
from dataclasses import replace

import pytest
from tests.study.questions.conftest import Stopped, content_of, lines_of, stops_at

import strandline as sl
from strandline.calibration import Observer
from strandline.calibration.experiment import FieldQuality
from strandline.cli import main
from strandline.foundations import InvalidInput
from strandline.interface import GaussianNoise, Interface
from strandline.questions.coverage import coverage
from strandline.studies.foresight.first_run import observations_of

FEWEST = "strandline.questions.coverage.FEWEST_REPLICATES"


@pytest.fixture(scope="module")
def answered(beam, tmp_path_factory):
    """A study with 20 replicates of its experiment."""
    folder = beam.copied(tmp_path_factory.mktemp("coverage") / "beam")
    return folder, sl.coverage(sl.load_study(folder), replicates=20)


def lines(folder):
    return lines_of(folder / "coverage.jsonl")


def test_what_it_writes(answered, beam):
    folder, found = answered
    noise = "independent errors of all coordinates, sd 3"
    content = content_of(found, 2, found.content["remarks"][0], noise, "64 runs", "coverage_ranks")
    assert (folder / "ledger.sqlite").read_bytes() == (beam.folder / "ledger.sqlite").read_bytes()
    assert (content["source"], content["seed"], content["measure"]) == ("prior", 1, "tracked_points")
    for item in content["inputs"].values():
        assert len(item["ranks"]) == 20
        assert item["p_value"] > 1e-3
        assert item["of_limit"] == pytest.approx(1.0, abs=0.25)


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
    monkeypatch.setattr(FEWEST, 6)
    content = coverage(study, replicates=6, source="posterior").content
    assert min(item["p_value"] for item in content["inputs"].values()) > 1e-3
    assert "with the posterior of the real observation as its prior" in (folder / "coverage.html").read_text("utf-8")
    assert len({json.loads(line)["of"] for line in lines(folder)}) == 5
    coverage(study, replicates=20)
    assert len(lines(folder)) == 31
    assert (folder / "coverage.json").read_bytes() == first


def test_the_command_prints_what_it_writes(folder, capsys):
    main(["coverage", str(folder), "--replicates", "21"])
    shown = capsys.readouterr()
    content = json.loads((folder / "coverage.json").read_text("utf-8"))
    assert shown.err.splitlines() == ["surrogate …", "replicates …", "  21 of 21", "figures and report …"]
    for words in (*content["remarks"], f"page: {folder / 'coverage.html'}"):
        assert words in shown.out
    for name, item in content["inputs"].items():
        row = next(line for line in shown.out.splitlines() if line.split()[:1] == [name])
        assert f"{item['intervals'][1]['found']:.1%}" in row


def test_a_coarse_surrogate_is_refused(folder, monkeypatch):
    coarse = FieldQuality(hidden=0.001, median=0.002, q95=0.004, left_out=0.003, beyond=0.62)
    monkeypatch.setattr("strandline.questions.coverage.field_quality", lambda source: coarse)
    with pytest.raises(InvalidInput, match=r"got errors above 0.5 µm at 62 % of the draws .* an active design"):
        coverage(sl.load_study(folder), source="posterior")
