"""Results read back, other posteriors from the same runs, and what `doctor` and `backup` make of a finished study."""

import sqlite3
from contextlib import closing

import numpy as np
import pytest
from tests.unit.cli.command_line import contents, ends, printed, refused

import strandline as sl
from strandline.foundations import InvalidInput, InvalidStudy
from strandline.runs import Ledger, RunRequest
from strandline.testing.studies import write_study


@pytest.fixture(scope="module")
def result(beam):
    return sl.load_result(str(beam.folder))


def runs_in(folder):
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        return ledger.counts().total


def test_it_is_what_the_study_wrote_and_other_noise_and_measures_need_no_run(beam, result):
    found, before = result.posterior, runs_in(beam.folder)
    for name, mean, sd in zip(found.space.names, found.mean, found.sd, strict=True):
        told = result.summary["inputs"][name]
        assert (told["mean"], told["sd"]) == pytest.approx((mean, sd))
    same = result.with_noise(0.003**2)
    np.testing.assert_allclose(same.posterior.draws, result.posterior.draws, rtol=1e-9)
    for one in (result, result.study, result.posterior, same):
        assert len(repr(one).splitlines()) == 1
        assert "</table>" in one._repr_html_()
    other = result.with_noise(sl.PointErrors(0.001), sl.NormalOffset())
    assert other.problem.discrepancies == {"NormalOffset": sl.NormalOffset()}
    assert (other.posterior.sd < result.posterior.sd).all()
    assert runs_in(beam.folder) == before


def test_what_there_is_not_is_refused(result, beam, copy_of, tmp_path):
    with pytest.raises(InvalidInput, match="above 0"):
        result.with_noise(0.0)
    with pytest.raises(InvalidStudy, match="not finished"):
        sl.load_result(write_study(tmp_path / "new"))
    folder = copy_of(beam)
    text = (folder / "study.yaml").read_text()
    (folder / "study.yaml").write_text(text + "# changed\n")
    with pytest.raises(InvalidStudy, match="no posterior to load: got results of an earlier study"):
        sl.load_result(folder)
    (folder / "study.yaml").write_text(text)
    (folder / "summary.json").unlink()
    with pytest.raises(InvalidStudy, match="no posterior to load"):
        sl.load_result(folder)


def tamper(folder):
    with closing(sqlite3.connect(folder / "ledger.sqlite")) as connection, connection:
        for name in ("outcomes_no_UPDATE", "outcomes_no_DELETE"):
            connection.execute(f"DROP TRIGGER {name}")
        connection.execute("UPDATE outcomes SET seconds = 7 WHERE attempt = 9")


def without_outcome(folder):
    with Ledger.open(folder / "ledger.sqlite", model="test:beam-1") as ledger:
        ledger.started(RunRequest("lost", {"E": 1.0}))
    text = (folder / "study.yaml").read_text().replace('"runs": 64', '"runs": 65')
    (folder / "study.yaml").write_text(text)


def answer_before(folder):
    for name in ANSWERS:
        (folder / name).write_text('{"study_sha256": "that of another study.yaml"}')


ANSWERS = ("check.json", "coverage.json", "next.json", "what-if.json", "specimens.json")
WRONG = (
    (tamper, "1 outcome(s) do not match their checksum"),
    (without_outcome, "1 of 65 planned runs have no outcome"),
    (lambda folder: (folder / ".summary.json.7.partial").touch(), "left by a process that was killed"),
    (lambda folder: (folder / "posterior.nc").unlink(), "missing next to summary.json: posterior.nc"),
    (answer_before, *(f"{name} is of another study.yaml" for name in ANSWERS)),
    (lambda folder: (folder / "study.yaml").write_text("version: 1\n"), "study.yaml cannot be used"),
)


def test_what_is_wrong_is_found_and_has_a_remedy(beam, tmp_path, capsys):
    for number, (spoil, *words) in enumerate(WRONG):
        folder = beam.copied(tmp_path / str(number))
        spoil(folder)
        assert ends("doctor", str(folder)) == 1
        shown = capsys.readouterr().out
        assert [word for word in words if word not in shown] == []
        assert "\n  -> " in shown


def test_a_finished_study_is_sound_and_a_backup_holds_all_its_runs(beam, copy_of, tmp_path, capsys):
    folder, target = copy_of(beam), tmp_path / "kept.sqlite"
    before = contents(folder)
    assert printed(capsys, "doctor", str(folder)) == "sound: nothing found\n"
    assert contents(folder) == before
    with Ledger.open(folder / "ledger.sqlite", model="test:beam-1") as driver:
        assert f"wrote {target}: 65 runs" in printed(capsys, "backup", str(folder), str(target))
        expected = [(record.key, record.state) for record in driver]
    with Ledger.open(target, model="test:beam-1", read_only=True) as copy:
        assert [(record.key, record.state) for record in copy] == expected
    content = target.read_bytes()
    refused(capsys, "backup", str(folder), str(target))
    assert target.read_bytes() == content
