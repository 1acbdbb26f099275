"""Many specimens of a study: files, resumption to the bit, known inputs, what is set aside, further runs, new files."""

import csv
import json
import re
import shutil
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests.study.questions.conftest import Stopped, content_of, lines_of, stops_at
from tests.unit.cli.command_line import ends

import strandline as sl
from strandline.cli import main
from strandline.foundations import InvalidInput, InvalidStudy, with_sd
from strandline.interface import Interface
from strandline.questions import specimens as module
from strandline.questions.specimen import Certified
from strandline.questions.specimens import specimens
from strandline.testing.studies import beam as true_beam

SPECIMENS = {"files": "all/*.csv", "read": {"unit": "mm"}}
TRUTHS = {f"s{k}.csv": (380.0 + 12 * k, 0.02) for k in range(5)}


def bent(E, tilt):
    return true_beam({"E": E, "tilt": tilt, "load": 1e-5}, Path()).interfaces[""]


def write_outline(folder, name, E, tilt, seed=0):
    points = bent(E, tilt).points
    noisy = points + 0.003 * np.random.default_rng(seed).standard_normal(points.shape)
    np.savetxt(folder / "all" / name, noisy, delimiter=",", fmt="%.6f")


def remove(folder, *names):
    for name in names:
        (folder / "all" / name).unlink()


def changed(folder, **said):
    """Return the study with other keys of `specimens`."""
    content = json.loads((folder / "study.yaml").read_text())
    (folder / "study.yaml").write_text(json.dumps({**content, "specimens": {**SPECIMENS, **said}}))
    return sl.load_study(folder)


def asked(folder, **options):
    return specimens(sl.load_study(folder), processes=1, **options)


@pytest.fixture(scope="module")
def answered(field, tmp_path_factory):
    """A finished study, five specimens and a file that is none, with an answer for each."""
    folder = field.copied(tmp_path_factory.mktemp("specimens") / "beam")
    changed(folder)
    (folder / "all").mkdir()
    for k, (name, truth) in enumerate(TRUTHS.items()):
        write_outline(folder, name, *truth, seed=k)
    (folder / "all" / "bad.csv").write_text("rubbish")
    return folder, asked(folder)


def lines(folder):
    return lines_of(folder / "specimens.jsonl")


def test_what_it_writes(answered, field):
    folder, found = answered
    content = content_of(found, 4, "Set aside", "bad.csv holds no points", "The population")
    assert (folder / "ledger.sqlite").read_bytes() == (field.folder / "ledger.sqlite").read_bytes()
    assert content["counts"] == {"files": 6, "analysed": 5, "good": 5, "refine": 0, "set_aside": 1}
    assert [one["specimen"] for one in content["specimens"]] == list(TRUTHS)
    for one in content["specimens"]:
        for item, truth in zip((one["inputs"]["E"], one["inputs"]["tilt"]), TRUTHS[one["specimen"]], strict=True):
            assert abs(item["mean"] - truth) < 4 * item["sd"]
            assert item["shrunk"]["sd"] <= 1.05 * item["sd"]
    with (folder / "specimens.csv").open(encoding="utf-8") as file:
        rows = {row["specimen"]: row for row in csv.DictReader(file)}
    assert rows["bad.csv"]["certificate"] == "set aside"
    assert float(rows["s1.csv"]["E_mean"]) == content["specimens"][1]["inputs"]["E"]["mean"]


def test_it_goes_on_where_it_was_stopped(folder, answered):
    """A half-written line is made again; the order and the other specimens change no bit."""
    (folder / "specimens.jsonl").unlink()
    with pytest.raises(Stopped):
        asked(folder, observer=stops_at(3))
    assert len(lines(folder)) == 2
    with (folder / "specimens.jsonl").open("ab") as file:
        file.write(b'{"of": "x", "spec')
    asked(folder)
    assert sorted(lines(folder)) == sorted(lines(answered[0]))
    for name in ("specimens.json", "specimens.csv"):
        assert (folder / name).read_bytes() == (answered[0] / name).read_bytes()


def test_only_what_changed_is_answered_again(folder):
    first = lines(folder)
    write_outline(folder, "s2.csv", 500.0, 0.03, seed=9)
    shutil.copy(folder / "all" / "s0.csv", folder / "all" / "zz.csv")
    found = asked(folder).content
    assert lines(folder)[:5] == first
    assert len(lines(folder)) == 7
    assert found["specimens"][2]["inputs"]["E"]["mean"] > 450
    assert "The files of s0.csv, zz.csv are the same: is it one specimen under several names?" in found["remarks"]
    remove(folder, "s2.csv", "s3.csv", "s4.csv", "zz.csv", "bad.csv")
    asked(folder, seed=2)
    assert len(lines(folder)) == 9


def test_known_inputs(folder, answered):
    """One has no row, one no number, and one a value outside the box."""
    (folder / "known.csv").write_text("file,tilt\ns0.csv,0.02\ns1.csv,0.3\ns2.csv,0.02\ns3.csv,x\ngone.csv,1\n")
    found = specimens(changed(folder, given="known.csv"), processes=1)
    why = {one["specimen"]: one["why"] for one in found.content["set_aside"]}
    assert sorted(why) == ["bad.csv", "s1.csv", "s3.csv", "s4.csv"]
    assert "known value of tilt: got 0.3; expected a number from 0 to 0.04" in why["s1.csv"]
    assert "got no number for tilt" in why["s3.csv"]
    assert [one.name for one in found.found.posteriors] == ["s0.csv", "s2.csv"]
    assert found.found.posteriors[0].sd[0] < answered[1].found.posteriors[0].sd[0]
    assert "No population: 2 specimens with a posterior, and at least 3 are needed." in found.content["remarks"]


def test_further_runs(folder, monkeypatch):
    """As long as certificates ask for them, at most as many as allowed; the study's own ledger is left alone."""
    before = (folder / "ledger.sqlite").read_bytes()
    remove(folder, "s2.csv", "s3.csv", "s4.csv")
    with monkeypatch.context() as patch:
        patch.setattr(Certified, "good", property(lambda self: False))
        found = asked(folder, refine=6, executor=sl.InProcess()).content
    assert found["surrogate"] == {"runs": 38, "further": 6, "made": 6}
    assert found["remarks"][0].startswith("The surrogate is not accurate enough for s0.csv, s1.csv")
    assert (folder / "ledger.sqlite").read_bytes() == before
    again = asked(folder, refine=6, executor=sl.InProcess()).content
    assert again["surrogate"] == {"runs": 38, "further": 6, "made": 0}


def test_an_outline_in_python(answered):
    opened, outline = sl.open_specimens(sl.load_study(answered[0])), bent(420.0, 0.01)
    one, turned = opened.posterior(outline), opened.posterior(outline.reversed())
    assert abs(one.mean[0] - 420) < 3 * one.sd[0]
    np.testing.assert_allclose(turned.mean, one.mean, rtol=1e-6)
    assert opened.posterior(outline, given={"tilt": 0.01}).sd[0] < one.sd[0]
    with pytest.raises(InvalidInput, match="expected about"):
        opened.posterior(Interface.polyline(1000 * outline.points))


def test_the_command_answers_new_files_as_they_arrive_until_ctrl_c(folder, capsys, monkeypatch):
    """One grows from look to look, and one can never be read."""
    remove(folder, "bad.csv")
    slow = folder / "all" / "slow.csv"
    write_outline(folder, "slow.csv", 450.0, 0.02)
    whole, looks, clock = slow.read_text(), iter(range(99)), SimpleNamespace(now=0.0)
    slow.unlink()

    def going_on():
        look = next(looks)
        if look == 0:
            (folder / "all" / "bad.csv").write_text("rubbish")
        if look <= 5:
            slow.write_text(whole[: 40 * (look + 1)] if look < 5 else whole)
        if look == 25:
            raise KeyboardInterrupt
        return True

    def wait(seconds):
        clock.now += seconds

    watched = partial(module.watch_specimens, going_on=going_on, clock=lambda: clock.now, wait=wait)
    monkeypatch.setattr(module, "watch_specimens", watched)
    assert ends("specimens", str(folder), "--watch") == 130
    begin, good, bad = capsys.readouterr().out.splitlines()
    assert begin.startswith("beam: 5 specimens known")
    assert re.match(r"slow\.csv: E 4\d\d.*, tilt .*; good \(", good)
    assert bad.startswith("bad.csv: set aside: ")
    assert len(lines(folder)) == 6


def test_the_command_prints_what_it_writes_and_names_an_outlier(folder, capsys):
    remove(folder, "bad.csv")
    for k in range(8):
        write_outline(folder, f"t{k:02}.csv", 400.0 + k, 0.02, seed=20 + k)
    write_outline(folder, "odd.csv", 550.0, 0.004, seed=50)
    main(["specimens", str(folder), "--processes", "1"])
    shown, content = capsys.readouterr().out, json.loads((folder / "specimens.json").read_text("utf-8"))
    for words in ("14 good, 0 to refine, 0 set aside", "Outliers: odd.csv (p below 0.0036).", "page: "):
        assert words in shown
    for name, item in content["population"]["inputs"].items():
        row = next(line for line in shown.splitlines() if line.split()[:1] == [name])
        assert with_sd(item["mean"]["mean"], item["mean"]["sd"]) in row
    assert "odd.csv (outlier)" in (folder / "specimens.html").read_text("utf-8")


def test_files_none_of_which_can_be_used_and_an_unfinished_study_are_refused(folder):
    with pytest.raises(InvalidStudy, match=r"specimens: none of the files can be used: got study\.y"):
        specimens(changed(folder, files="study.yaml"), processes=1)
    (folder / "ledger.sqlite").unlink()
    with pytest.raises(InvalidStudy, match="the study is not finished"):
        specimens(changed(folder))
