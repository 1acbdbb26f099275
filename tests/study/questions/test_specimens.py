"""Many specimens of a study: files, resumption to the bit, known inputs, what is set aside, further runs, new files."""

import csv
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filelock import FileLock
from tests.study.conftest import Finished
from tests.study.questions.pages import described_in, keys_of
from tests.unit.cli.command_line import Shown, ends

import strandline as sl
from strandline.calibration import Observer
from strandline.cli import main
from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import Interface
from strandline.population import Refused, SpecimenPosterior
from strandline.population.certificate import Certified
from strandline.questions.specimens import StudySpecimens, specimens, watch
from strandline.runs import Ledger, Progress
from strandline.testing.studies import beam as true_beam
from strandline.text import with_sd

SD = 0.003
SPECIMENS = {"files": "all/*.csv", "read": {"unit": "mm"}}
TRUTHS = {f"s{k}.csv": (380.0 + 12 * k, 0.02) for k in range(5)}


def bent(E: float, tilt: float) -> Interface:
    return true_beam({"E": E, "tilt": tilt, "load": 1e-5}, Path()).interfaces[""]


def write_outline(path: Path, E: float, tilt: float, seed: int = 0) -> None:
    true = bent(E, tilt)
    points = true.points + SD * np.random.default_rng(seed).standard_normal(true.points.shape)
    path.write_text("\n".join(f"{x:.6f},{y:.6f}" for x, y in points))


def changed(folder: Path, **said: Any) -> sl.Study:
    """Return the study with other keys of `specimens`."""
    content = json.loads((folder / "study.yaml").read_text())
    (folder / "study.yaml").write_text(json.dumps({**content, "specimens": {**SPECIMENS, **said}}))
    return sl.load_study(folder)


@pytest.fixture(scope="module")
def bare(field: Finished, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished study with five specimens and a file that is none."""
    folder = Path(shutil.copytree(field.folder, tmp_path_factory.mktemp("specimens") / "beam"))
    changed(folder)
    (folder / "all").mkdir()
    for k, (name, truth) in enumerate(TRUTHS.items()):
        write_outline(folder / "all" / name, *truth, seed=k)
    (folder / "all" / "bad.csv").write_text("rubbish")
    return folder


@pytest.fixture(scope="module")
def answered(bare: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, StudySpecimens]:
    """That study with an answer for each specimen."""
    folder = Path(shutil.copytree(bare, tmp_path_factory.mktemp("answered") / "beam"))
    return folder, specimens(sl.load_study(folder), processes=1)


@pytest.fixture
def folder(answered: tuple[Path, StudySpecimens], tmp_path: Path) -> Path:
    """A copy of the answered study, which the test may change."""
    return Path(shutil.copytree(answered[0], tmp_path / "beam"))


def lines(folder: Path) -> list[str]:
    return (folder / "specimens.jsonl").read_text("utf-8").splitlines()


def test_what_it_writes(answered: tuple[Path, StudySpecimens], field: Finished) -> None:
    folder, found = answered
    content = json.loads((folder / "specimens.json").read_text("utf-8"))
    assert content == json.loads(json.dumps(found.content))
    assert (folder / "ledger.sqlite").read_bytes() == (field.folder / "ledger.sqlite").read_bytes()
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
    assert len(list((folder / "figures").glob("specimens_*.png"))) == 4
    assert repr(found) == "<StudySpecimens of beam: 5 specimens, 5 good, 1 set aside>"
    named = {"versions": "PACKAGE", "inputs": "NAME", "specimens[].inputs": "NAME", "population.inputs": "NAME"}
    assert described_in("specimens.md") == keys_of(found.content, named, whole=("given",))


class Stopped(Exception):
    """The command is stopped."""


def test_it_goes_on_where_it_was_stopped(bare: Path, answered: tuple[Path, StudySpecimens], tmp_path: Path) -> None:
    """A half-written line is made again; the order and the other specimens change no bit."""
    folder = Path(shutil.copytree(bare, tmp_path / "beam"))

    def part(state: Progress) -> None:
        if state.finished == 3:
            raise Stopped

    with pytest.raises(Stopped):
        specimens(sl.load_study(folder), processes=1, observer=Observer(part=part))
    assert len(lines(folder)) == 2
    with (folder / "specimens.jsonl").open("ab") as file:
        file.write(b'{"of": "x", "spec')
    specimens(sl.load_study(folder), processes=1)
    assert sorted(lines(folder)) == sorted(lines(answered[0]))
    for name in ("specimens.json", "specimens.csv"):
        assert (folder / name).read_bytes() == (answered[0] / name).read_bytes()


def test_only_what_changed_is_answered_again(folder: Path) -> None:
    first = lines(folder)
    write_outline(folder / "all" / "s2.csv", 500.0, 0.03, seed=9)
    shutil.copy(folder / "all" / "s0.csv", folder / "all" / "zz.csv")
    found = specimens(sl.load_study(folder), processes=1).content
    assert lines(folder)[:5] == first
    assert len(lines(folder)) == 7
    assert found["specimens"][2]["inputs"]["E"]["mean"] > 450
    assert found["alike"] == [["s0.csv", "zz.csv"]]
    assert "The files of s0.csv, zz.csv are the same: is it one specimen under several names?" in found["remarks"]
    for name in ("s2.csv", "s3.csv", "s4.csv", "zz.csv", "bad.csv"):
        (folder / "all" / name).unlink()
    specimens(sl.load_study(folder), seed=2, processes=1)
    assert len(lines(folder)) == 9


def test_known_inputs(folder: Path, answered: tuple[Path, StudySpecimens]) -> None:
    """One has no row, one no number, and one a value outside the box."""
    values = {"s0.csv": "0.02", "s1.csv": "0.3", "s2.csv": "0.02", "s3.csv": "x", "bad.csv": "0.02", "gone.csv": "1"}
    rows = "".join(f"{name},{value}\n" for name, value in values.items())
    (folder / "known.csv").write_text(f"file,tilt\n{rows}")
    found = specimens(changed(folder, given="known.csv"), processes=1)
    assert list(found.content["inputs"]) == ["E"]
    assert found.content["given"] == ["tilt"]
    assert all(one.given == {"tilt": 0.02} for one in found.posteriors)
    why = {one["specimen"]: one["why"] for one in found.content["set_aside"]}
    assert sorted(why) == ["bad.csv", "s1.csv", "s3.csv", "s4.csv"]
    assert "known value of tilt: got 0.3; expected a number from 0 to 0.04" in why["s1.csv"]
    assert "got no number for tilt" in why["s3.csv"]
    assert "known inputs of s4.csv: got no row in the table" in why["s4.csv"]
    free = {one.name: one for one in answered[1].posteriors}
    assert [one.name for one in found.posteriors] == ["s0.csv", "s2.csv"]
    assert all(one.sd[0] < free[one.name].sd[0] for one in found.posteriors)
    assert found.content["population"] is None
    assert "shrunk" not in found.content["specimens"][0]["inputs"]["E"]
    assert "No population: 2 specimens with a posterior, and at least 3 are needed." in found.content["remarks"]


def test_an_outlier_is_named(folder: Path, capsys: Shown) -> None:
    (folder / "all" / "bad.csv").unlink()
    for k in range(8):
        write_outline(folder / "all" / f"t{k:02}.csv", 400.0 + k, 0.02, seed=20 + k)
    write_outline(folder / "all" / "odd.csv", 550.0, 0.004, seed=50)
    main(["specimens", str(folder), "--quiet", "--processes", "1"])
    assert "Outliers: odd.csv (p below 0.0036)." in capsys.readouterr().out
    assert "odd.csv (outlier)" in (folder / "specimens.html").read_text("utf-8")


def test_further_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As long as certificates ask for them, at most as many as allowed; the study's own ledger is left alone."""
    before = (folder / "ledger.sqlite").read_bytes()
    for name in ("s2.csv", "s3.csv", "s4.csv"):
        (folder / "all" / name).unlink()
    options: dict[str, Any] = {"refine": 6, "executor": sl.InProcess(), "processes": 1}
    monkeypatch.setattr(Certified, "good", property(lambda self: False))
    found = specimens(sl.load_study(folder), **options).content
    assert found["surrogate"] == {"runs": 38, "further": 6, "made": 6}
    assert found["remarks"][0].startswith("The surrogate is not accurate enough for s0.csv, s1.csv")
    with Ledger.open(folder / "specimens.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().total == 6
    assert (folder / "ledger.sqlite").read_bytes() == before
    monkeypatch.undo()
    again = specimens(sl.load_study(folder), **options).content
    assert again["surrogate"] == {"runs": 38, "further": 6, "made": 0}


def test_two_at_once_do_not_mix(bare: Path) -> None:
    with FileLock(bare / "specimens.jsonl.lock"), pytest.raises(InvalidStudy, match="one at a time"):
        specimens(sl.load_study(bare))
    assert not list(bare.glob("specimens.j*n*"))[1:]


def test_an_outline_in_python(bare: Path) -> None:
    opened = sl.open_specimens(sl.load_study(bare))
    one = opened.posterior(bent(420.0, 0.01))
    assert abs(one.mean[0] - 420) < 3 * one.sd[0]
    turned = opened.posterior(bent(420.0, 0.01).reversed())
    np.testing.assert_allclose(turned.mean, one.mean, rtol=1e-6)
    known = opened.posterior(bent(420.0, 0.01), given={"tilt": 0.01})
    assert known.sd[0] < one.sd[0]
    with pytest.raises(InvalidInput, match="expected about"):
        opened.posterior(Interface.polyline(1000 * bent(420.0, 0.01).points))
    assert repr(opened) == "<Specimens of beam: surrogate of 32 runs>"


class Clock:
    """A clock that goes on only where somebody waits."""

    now = 0.0

    def __call__(self) -> float:
        return self.now

    def wait(self, seconds: float) -> None:
        self.now += seconds


def test_new_files_are_answered_as_they_arrive(folder: Path) -> None:
    """One is complete at once, one grows from look to look, and one can never be read."""
    (folder / "all" / "bad.csv").unlink()
    whole = "\n".join(f"{x:.6f},{y:.6f}" for x, y in bent(450.0, 0.02).points)
    looks, clock, known = iter(range(99)), Clock(), list[int]()

    def going_on() -> bool:
        look = next(looks)
        if look == 0:
            write_outline(folder / "all" / "new.csv", 450.0, 0.02)
            (folder / "all" / "bad.csv").write_text("rubbish")
        if look < 5:
            (folder / "all" / "slow.csv").write_text(whole[: 40 * (look + 1)])
        if look == 5:
            (folder / "all" / "slow.csv").write_text(whole)
        return look < 25

    study = sl.load_study(folder)
    watching = watch.watch_specimens(study, ready=known.append, going_on=going_on, clock=clock, wait=clock.wait)
    arrived = [(one.answer, clock.now) for one in watching]
    answers = {one.name: one for one, _ in arrived}
    assert known == [5]
    assert [one.name for one, _ in arrived] == ["new.csv", "slow.csv", "bad.csv"]
    assert [at for _, at in arrived] == pytest.approx([0.1, 0.6, 2.0])
    assert isinstance(answers["bad.csv"], Refused)
    for name in ("new.csv", "slow.csv"):
        one = answers[name]
        assert isinstance(one, SpecimenPosterior)
        assert abs(one.mean[0] - 450) < 4 * one.sd[0]
    assert len(lines(folder)) == 7


def test_the_command_watches(
    answered: tuple[Path, StudySpecimens], capsys: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = answered[1].posteriors[0]

    def arriving(study: sl.Study, *, ready: Any, **others: Any) -> Iterator[watch.Arrived]:
        ready(5)
        yield watch.Arrived(one, 0.25)
        yield watch.Arrived(Refused("bad.csv", "no points"), 0.1)
        raise KeyboardInterrupt

    monkeypatch.setattr(watch, "watch_specimens", arriving)
    assert ends("specimens", str(answered[0]), "--watch") == 130
    known, first, second = capsys.readouterr().out.splitlines()
    assert known == "beam: 5 specimens known; waiting for new ones (Ctrl-C ends)"
    assert (
        first == f"s0.csv: E {with_sd(one.mean[0], one.sd[0])}, tilt {with_sd(one.mean[1], one.sd[1])}; good (0.25 s)"
    )
    assert second == "bad.csv: set aside: no points"


def test_the_command_prints_what_it_writes(folder: Path, capsys: Shown) -> None:
    main(["specimens", str(folder)])
    shown = capsys.readouterr()
    content = json.loads((folder / "specimens.json").read_text("utf-8"))
    assert "beam: 5 specimens from 32 runs; 5 good, 0 to refine, 1 set aside" in shown.out
    for name, item in content["population"]["inputs"].items():
        row = next(line for line in shown.out.splitlines() if line.split()[:1] == [name])
        assert with_sd(item["mean"]["mean"], item["mean"]["sd"]) in row
    assert "no outliers" in shown.out
    assert f"page: {folder / 'specimens.html'}" in shown.out
    assert [line for line in shown.err.splitlines() if line.endswith("…")][:2] == ["surrogate …", "specimens …"]


def test_files_none_of_which_can_be_used_are_refused(bare: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(bare, tmp_path / "beam"))
    with pytest.raises(InvalidStudy, match=r"specimens: none of the files can be used: got study\.y"):
        specimens(changed(folder, files="study.yaml"), processes=1)
    (folder / "ledger.sqlite").unlink()
    with pytest.raises(InvalidStudy, match="the study is not finished"):
        specimens(changed(folder))
