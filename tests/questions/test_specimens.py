"""Many specimens of a study: files, resumption to the bit, known inputs, what is set aside, further runs, new files."""

import csv
import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from filelock import FileLock
from tests.questions.pages import Check, described_in, keys_of

import strandline as sl
from strandline.calibration import Observer
from strandline.cli import main
from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import Interface
from strandline.population import Refused, SpecimenPosterior
from strandline.population.certificate import Certified
from strandline.questions.specimens.files import specimen_files
from strandline.questions.specimens.study_specimens import specimens
from strandline.runs import Ledger, Progress
from strandline.testing.studies import TWO_LOADS_STUDY, beam, write_study
from strandline.text import with_sd

SD = 0.003
SMALL = {"sampler": {"smc": {"particles": 2000, "rejuvenation_steps": 4}}, "surrogate": {"field": {}}}
FILES = ("specimens.json", "specimens.csv", "specimens.jsonl", "specimens.html")
SPECIMENS = {"files": "all/*.csv", "read": {"unit": "mm"}}
TRUTHS = {f"s{k}.csv": (380.0 + 12 * k, 0.02) for k in range(5)}


def bent(E: float, tilt: float, load: float = 1e-5) -> Interface:
    return beam({"E": E, "tilt": tilt, "load": load}, Path()).interfaces[""]


def write_outline(path: Path, E: float, tilt: float, seed: int = 0) -> None:
    true = bent(E, tilt)
    points = true.points + SD * np.random.default_rng(seed).standard_normal(true.points.shape)
    path.write_text("\n".join(f"{x:.6f},{y:.6f}" for x, y in points))


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished study of five specimens."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
        folder = write_study(tmp_path_factory.mktemp("specimens") / "beam", **SMALL, specimens=SPECIMENS)
        write(folder, {})
        sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    (folder / "all").mkdir()
    for k, (name, truth) in enumerate(TRUTHS.items()):
        write_outline(folder / "all" / name, *truth, seed=k)
    return folder


@pytest.fixture(autouse=True)
def quick(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sample the population less often, and draw figures only where a test looks at them."""
    monkeypatch.setattr("strandline.population.hierarchy.ENOUGH", 300.0)
    if request.node.name != "test_what_it_writes":
        monkeypatch.setattr("strandline.report.page.draw_specimens", lambda content: ())


def bits(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in FILES}


def lines(folder: Path) -> list[str]:
    return (folder / "specimens.jsonl").read_text("utf-8").splitlines()


def write(folder: Path, said: Mapping[str, Any]) -> None:
    """Write study.yaml with some of its keys changed; None removes a key."""
    content = {**yaml.safe_load((folder / "study.yaml").read_text()), **said}
    kept = {key: value for key, value in content.items() if value is not None}
    (folder / "study.yaml").write_text(yaml.safe_dump(kept, sort_keys=False))


def changed(folder: Path, **said: Any) -> sl.Study:
    """Return the study with other keys of `specimens`."""
    write(folder, {"specimens": {**SPECIMENS, **said}})
    return sl.load_study(folder)


def test_what_it_writes(folder: Path) -> None:
    before = (folder / "ledger.sqlite").read_bytes()
    (folder / "all" / "bad.csv").write_text("rubbish")
    found = sl.specimens(sl.load_study(folder))
    content = json.loads((folder / "specimens.json").read_text("utf-8"))
    assert content == json.loads(json.dumps(found.content))
    assert (folder / "ledger.sqlite").read_bytes() == before
    assert content["counts"] == {"files": 6, "analysed": 5, "good": 5, "refine": 0, "set_aside": 1}
    assert [one["specimen"] for one in content["specimens"]] == list(TRUTHS)
    assert content["set_aside"][0]["specimen"] == "bad.csv"
    assert "bad.csv holds no points" in content["set_aside"][0]["why"]
    for one, posterior in zip(content["specimens"], found.posteriors, strict=True):
        E, tilt = TRUTHS[one["specimen"]]
        for name, truth in (("E", E), ("tilt", tilt)):
            item = one["inputs"][name]
            assert abs(item["mean"] - truth) < 4 * item["sd"]
            assert item["shrunk"]["sd"] <= 1.05 * item["sd"]
        assert posterior.name == one["specimen"]
    with (folder / "specimens.csv").open(encoding="utf-8") as file:
        rows = {row["specimen"]: row for row in csv.DictReader(file)}
    assert rows["bad.csv"]["certificate"] == "set aside"
    assert float(rows["s1.csv"]["E_mean"]) == content["specimens"][1]["inputs"]["E"]["mean"]
    page = found.page.read_text("utf-8")
    assert "<script" not in page
    assert page.count("<img ") == page.count('src="data:image/png') == 4
    for words in ("Set aside", "bad.csv holds no points", "The population"):
        assert words in page
    assert len(list((folder / "figures").glob("specimens_*.pdf"))) == 4
    assert repr(found) == "<StudySpecimens of beam: 5 specimens, 5 good, 1 set aside>"


def test_a_study_stays_current(folder: Path) -> None:
    """The key only asks a question: results of the study stay valid with it, without it and with another one."""
    digest = sl.load_study(folder).text_digest
    assert changed(folder, files="others/*.csv").text_digest == digest


class Stopped(Exception):
    """The command is stopped."""


def stop_after(number: int) -> Observer:
    def part(state: Progress) -> None:
        if state.finished == number:
            raise Stopped

    return Observer(part=part)


def test_it_goes_on_where_it_was_stopped(folder: Path, tmp_path: Path) -> None:
    """A half-written line is made again; order, processes and the other specimens change no bit."""
    shutil.copytree(folder, tmp_path / "whole")
    specimens(sl.load_study(tmp_path / "whole"))
    with pytest.raises(Stopped):
        specimens(sl.load_study(folder), observer=stop_after(3))
    assert len(lines(folder)) == 3
    with (folder / "specimens.jsonl").open("ab") as file:
        file.write(b'{"of": "x", "spec')
    specimens(sl.load_study(folder), processes=2)
    assert bits(folder).keys() == bits(tmp_path / "whole").keys()
    assert sorted(lines(folder)) == sorted(lines(tmp_path / "whole"))
    for name in ("specimens.json", "specimens.csv"):
        assert bits(folder)[name] == bits(tmp_path / "whole")[name]


def test_only_what_changed_is_answered_again(folder: Path) -> None:
    specimens(sl.load_study(folder))
    first = lines(folder)
    write_outline(folder / "all" / "s2.csv", 500.0, 0.03, seed=9)
    content = specimens(sl.load_study(folder)).content
    assert lines(folder)[:5] == first
    assert len(lines(folder)) == 6
    assert content["specimens"][2]["inputs"]["E"]["mean"] > 450
    specimens(sl.load_study(folder), seed=2)
    assert len(lines(folder)) == 11


def test_known_inputs(folder: Path) -> None:
    (folder / "known.csv").write_text(
        "file,tilt\n" + "".join(f"{name},0.02\n" for name in [*TRUTHS][:4]) + "gone.csv,1"
    )
    study = changed(folder, given="known.csv")
    found = specimens(study)
    assert list(found.content["inputs"]) == ["E"]
    assert found.content["given"] == ["tilt"]
    assert all(one.given == {"tilt": 0.02} for one in found.posteriors)
    (aside,) = found.content["set_aside"]
    assert aside["specimen"] == "s4.csv"
    assert "known inputs of s4.csv: got no row in the table" in aside["why"]
    free = specimens(changed(folder)).posteriors
    assert all(one.sd[0] < other.sd[0] for one, other in zip(found.posteriors, free, strict=False))


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("file,weight\ns0.csv,1\n", "columns of known.csv: got file, weight; expected file and some, not all"),
        ("file,E,tilt\ns0.csv,400,0.02\n", "some, not all"),
        ("", "got none"),
        (None, "specimens.given: got known.csv"),
        ("file,tilt\ns0.csv,0.02\ns0.csv,0.03\n", "rows of known.csv: got several for s0.csv"),
    ],
)
def test_tables_that_are_refused(table: str | None, words: str, folder: Path) -> None:
    if table is not None:
        (folder / "known.csv").write_text(table)
    with pytest.raises(InvalidStudy, match=re.escape(words)):
        specimens(changed(folder, given="known.csv"))


def test_tables_beside_the_outlines_are_no_outlines(folder: Path) -> None:
    for name in ("known.csv", "specimens.csv", "s0.csv"):
        shutil.copy(folder / "all" / "s0.csv", folder / name)
    (folder / "known.csv").write_text("file,tilt\ns0.csv,0.02\n")
    files = specimen_files(changed(folder, files="*.csv", given="known.csv"))
    assert [path.name for path in files.paths] == ["s0.csv"]


def test_values_outside_the_box_are_set_aside(folder: Path) -> None:
    rows = "".join(f"{name},{0.3 if name == 's1.csv' else 0.02}\n" for name in TRUTHS).replace(
        "s3.csv,0.02", "s3.csv,x"
    )
    (folder / "known.csv").write_text(f"file,tilt\n{rows}")
    aside = specimens(changed(folder, given="known.csv")).content["set_aside"]
    assert [one["specimen"] for one in aside] == ["s1.csv", "s3.csv"]
    assert "known value of tilt: got 0.3; expected a number from 0 to 0.04" in aside[0]["why"]
    assert "got no number for tilt" in aside[1]["why"]


@pytest.mark.parametrize("left", [1, 2])
def test_few_specimens_have_no_population(left: int, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in [*TRUTHS][left:]:
        (folder / "all" / name).unlink()
    main(["specimens", str(folder), "--quiet"])
    plural = "s" if left > 1 else ""
    said = f"No population: {left} specimen{plural} with a posterior, and at least 3 are needed."
    assert [line for line in capsys.readouterr().out.splitlines() if "population" in line] == [said]
    content = json.loads((folder / "specimens.json").read_text("utf-8"))
    assert content["population"] is None
    assert len(content["specimens"]) == left
    assert "shrunk" not in content["specimens"][0]["inputs"]["E"]


def test_files_with_the_same_content_are_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, *_ = sorted((folder / "all").iterdir())
    shutil.copy(first, first.with_name("zz.csv"))
    main(["specimens", str(folder), "--quiet"])
    assert json.loads((folder / "specimens.json").read_text("utf-8"))["alike"] == [[first.name, "zz.csv"]]
    assert f"The files of {first.name}, zz.csv are the same" in capsys.readouterr().out


def test_an_outlier_is_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for k in range(12):
        write_outline(folder / "all" / f"t{k:02}.csv", 400.0 + k, 0.02, seed=20 + k)
    write_outline(folder / "all" / "odd.csv", 550.0, 0.004, seed=50)
    main(["specimens", str(folder), "--quiet"])
    assert "Outliers: odd.csv (p below 0.0028)." in capsys.readouterr().out
    assert "odd.csv (outlier)" in (folder / "specimens.html").read_text("utf-8")


def test_further_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As long as certificates ask for them, at most as many as allowed; the study's own ledger is left alone."""
    before = (folder / "ledger.sqlite").read_bytes()
    monkeypatch.setattr(Certified, "good", property(lambda self: False))
    found = specimens(sl.load_study(folder), refine=6, executor=sl.InProcess())
    assert found.content["surrogate"] == {"runs": 70, "further": 6, "made": 6}
    assert found.content["remarks"][0].startswith("The surrogate is not accurate enough for s0.csv, s1.csv")
    with Ledger.open(folder / "specimens.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().total == 6
    assert (folder / "ledger.sqlite").read_bytes() == before
    monkeypatch.undo()
    again = specimens(sl.load_study(folder), refine=6, executor=sl.InProcess()).content
    assert again["surrogate"] == {"runs": 70, "further": 6, "made": 0}


def test_two_at_once_do_not_mix(folder: Path) -> None:
    with FileLock(folder / "specimens.jsonl.lock"), pytest.raises(InvalidStudy, match="one at a time"):
        specimens(sl.load_study(folder))
    assert not any((folder / name).exists() for name in FILES)


def test_an_outline_in_python(folder: Path) -> None:
    opened = sl.open_specimens(sl.load_study(folder))
    one = opened.posterior(bent(420.0, 0.01))
    assert abs(one.mean[0] - 420) < 3 * one.sd[0]
    turned = opened.posterior(bent(420.0, 0.01).reversed())
    np.testing.assert_allclose(turned.mean, one.mean, rtol=1e-6)
    known = opened.posterior(bent(420.0, 0.01), given={"tilt": 0.01})
    assert known.sd[0] < one.sd[0]
    with pytest.raises(InvalidInput, match="expected about"):
        opened.posterior(Interface.polyline(1000 * bent(420.0, 0.01).points))
    assert repr(opened) == "<Specimens of beam: surrogate of 64 runs>"


def test_new_files_are_answered_as_they_arrive(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One is complete at once, one grows from look to look, and one can never be read."""
    monkeypatch.setattr("strandline.questions.specimens.watch.PAUSE", 0.0)
    monkeypatch.setattr("strandline.questions.specimens.watch.PATIENCE", 0.0)
    whole = "\n".join(f"{x:.6f},{y:.6f}" for x, y in bent(450.0, 0.02).points)
    looks = iter(range(9))

    def going_on() -> bool:
        look = next(looks)
        if look == 0:
            write_outline(folder / "all" / "new.csv", 450.0, 0.02)
            (folder / "all" / "bad.csv").write_text("rubbish")
        if look < 5:
            (folder / "all" / "slow.csv").write_text(whole[: 40 * (look + 1)])
        if look == 5:
            (folder / "all" / "slow.csv").write_text(whole)
        return look < 8

    known: list[int] = []
    arrived = list(sl.watch_specimens(sl.load_study(folder), ready=known.append, going_on=going_on))
    answers = {one.answer.name: one.answer for one in arrived}
    assert known == [5]
    assert sorted(answers) == ["bad.csv", "new.csv", "slow.csv"]
    assert len(arrived) == 3
    assert isinstance(answers["bad.csv"], Refused)
    for name in ("new.csv", "slow.csv"):
        one = answers[name]
        assert isinstance(one, SpecimenPosterior)
        assert abs(one.mean[0] - 450) < 4 * one.sd[0]
    assert len(lines(folder)) == 7


def test_the_command_watches(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("strandline.questions.specimens.watch.time.sleep", interrupted)
    with pytest.raises(SystemExit) as ended:
        main(["specimens", str(folder), "--watch"])
    assert ended.value.code == 130
    assert capsys.readouterr().out == "beam: 5 specimens known; waiting for new ones (Ctrl-C ends)\n"
    with pytest.raises(SystemExit):
        main(["specimens", str(folder), "--watch", "--refine", "3"])
    assert "--watch makes no forward runs" in capsys.readouterr().err


def test_the_command_prints_what_it_writes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["specimens", str(folder)])
    shown = capsys.readouterr()
    content = json.loads((folder / "specimens.json").read_text("utf-8"))
    assert "beam: 5 specimens from 64 runs; 5 good, 0 to refine, 0 set aside" in shown.out
    for name, item in content["population"]["inputs"].items():
        row = next(line for line in shown.out.splitlines() if line.split()[:1] == [name])
        assert with_sd(item["mean"]["mean"], item["mean"]["sd"]) in row
    assert "no outliers" in shown.out
    assert f"page: {folder / 'specimens.html'}" in shown.out
    assert [line for line in shown.err.splitlines() if line.endswith("…")][:2] == ["surrogate …", "specimens …"]


REFUSED: list[tuple[list[str], Mapping[str, Any], str]] = [
    (["--measure", "currents"], {}, "measure of the specimens: got currents; expected one of the study's: tracked_"),
    (["--seed", "-1"], {}, "--seed"),
    (["--processes", "0"], {}, "--processes"),
    (["--watch", "--processes", "2"], {}, "--watch analyses one file at a time: leave out --processes."),
    ([], {"specimens": None}, "study.yaml names no specimens: got beam; expected the key specimens"),
    ([], {"specimens": "none/*.csv"}, "specimens: how to read the files: got observation.synthetic"),
    ([], {"specimens": {**SPECIMENS, "files": "none/*.csv"}}, "specimens: got no file none/*.csv in "),
    ([], {"specimens": {**SPECIMENS, "read": {"unit": "inch"}}}, "study.yaml: specimens.read.unit: got inch"),
    ([], {"specimens": {"file": "all/*.csv"}}, "unknown key"),
    ([], {"specimens": {**SPECIMENS, "files": "**.csv"}}, "specimens.files: got **.csv; expected a pattern of files"),
    (
        [],
        {"specimens": {**SPECIMENS, "files": "study.yaml"}},
        "specimens: none of the files can be used: got study.y",
    ),
]


@pytest.mark.parametrize(("options", "said", "words"), REFUSED)
def test_what_is_refused(options: list[str], said: Mapping[str, Any], words: str, folder: Path, refused: Check) -> None:
    write(folder, said)
    refused(["specimens", str(folder), "--quiet", *options], words, folder)


def test_an_unfinished_study_is_refused(folder: Path) -> None:
    (folder / "ledger.sqlite").unlink()
    with pytest.raises(InvalidStudy, match="the study is not finished"):
        specimens(sl.load_study(folder))


def test_several_conditions_are_refused(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "two", **{**TWO_LOADS_STUDY, "specimens": SPECIMENS})
    with pytest.raises(InvalidStudy, match="specimens of a model with several conditions: got light, heavy"):
        specimens(sl.load_study(folder))


def test_every_key_is_described(folder: Path) -> None:
    (folder / "all" / "bad.csv").write_text("rubbish")
    found = specimens(sl.load_study(folder)).content
    named = {"versions": "PACKAGE", "inputs": "NAME", "specimens[].inputs": "NAME", "population.inputs": "NAME"}
    assert described_in("specimens.md") == keys_of(found, named, whole=("given",))
