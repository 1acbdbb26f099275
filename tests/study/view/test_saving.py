"""Other assumptions become a new study, which takes over the runs and gives the posterior that the page showed."""

from collections.abc import Callable
from pathlib import Path

import pytest
from tests.study.conftest import Finished

import strandline as sl
from strandline.errors import InvalidInput
from strandline.view.assumptions import Asked, answer_to, asked_by
from strandline.view.saving import save_as
from strandline.view.viewed import ViewedStudy

PLAIN = Asked(1.0, None, None, {}, {})


@pytest.fixture
def folder(field: Finished, copy_of: Callable[[Finished], Path]) -> Path:
    """A copy of a finished study."""
    return copy_of(field)


def test_the_new_study_gives_the_posterior_that_the_page_showed(folder: Path) -> None:
    study = sl.load_study(folder)
    viewed = ViewedStudy(study)
    viewed.feed.update()
    viewed.newest.refresh(viewed.feed.succeeded)
    assert viewed.newest.shown.now is not None
    asked = asked_by({"noise": 2.0, "length_um": 20.0, "priors": {"E": {"normal": [420.0, 30.0]}}}, study)
    shown = answer_to(asked, study, viewed.newest.shown.now, again=True)
    target = save_as(study, "wider", asked)
    assert target == folder.parent / "wider"
    other = sl.load_study(target)
    assert isinstance(other.noise, sl.PointErrors)
    assert other.noise.sd == pytest.approx(0.006)
    assert other.noise.length == pytest.approx(0.02)
    assert not (target / "posterior.nc").exists()
    text = (target / "study.yaml").read_text()
    (target / "study.yaml").write_text(text.replace('"draft": true', '"draft": true, "report": "none"'))
    outcome = sl.run_study(sl.load_study(target), executor=sl.InProcess())
    assert not outcome.calibration.made
    assert shown.draws is not None
    for k in range(2):
        mean, sd = outcome.calibration.posterior.mean[k], outcome.calibration.posterior.sd[k]
        assert shown.draws.mean[k] == pytest.approx(mean, abs=0.15 * sd)
        assert shown.draws.sd[k] == pytest.approx(sd, rel=0.12)


def test_inputs_that_are_known_and_another_measure(folder: Path) -> None:
    study = sl.load_study(folder)
    asked = asked_by({"fixed": {"tilt": 0.02}, "measure": "tracked_points"}, study)
    other = sl.load_study(save_as(study, "known", asked))
    assert other.space.names == ("E",)
    assert other.fixed == {"load": 1e-5, "tilt": 0.02}
    assert next(iter(other.discrepancies)) == "tracked_points"
    assert other.reuse[0].parent.resolve() == folder.resolve()


def test_names_that_are_refused(folder: Path) -> None:
    before, study = sorted(path.name for path in folder.parent.iterdir()), sl.load_study(folder)
    for name in ("", "../there", "a/b", ".hidden", "a" * 64, "a\nb", "ünï", folder.name):
        with pytest.raises(InvalidInput, match="name of the new study"):
            save_as(study, name, PLAIN)
    assert sorted(path.name for path in folder.parent.iterdir()) == before


def test_nothing_is_left_of_a_study_that_cannot_be_written(folder: Path) -> None:
    study = sl.load_study(folder)
    wrong = Asked(1.0, None, None, {"E": {"uniform": [0.0, 1000.0]}}, {})
    with pytest.raises(InvalidInput):
        save_as(study, "wrong", wrong)
    assert not (folder.parent / "wrong").exists()


def test_comments_stay(folder: Path) -> None:
    text = (folder / "study.yaml").read_text()
    inner = text.strip().removeprefix("{").removesuffix("}").strip().removesuffix(",")
    (folder / "study.yaml").write_text(f"{{  # by hand\n  {inner}  # the last\n}}\n")
    asked = asked_by({"noise": 2.0, "priors": {"E": {"normal": [420.0, 30.0]}}}, sl.load_study(folder))
    new = (save_as(sl.load_study(folder), "commented", asked) / "study.yaml").read_text()
    assert new.startswith("# commented: beam with other assumptions\n{  # by hand\n")
    assert "# the last" in new
