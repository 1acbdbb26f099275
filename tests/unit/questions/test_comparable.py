"""Which studies can be compared, and what they are called."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import strandline as sl
from strandline.errors import InvalidInput, InvalidStudy
from strandline.planning.candidate import Candidate, Look
from strandline.questions.compare.comparable import labels_of, may_err, require_comparable, require_several
from strandline.questions.compare.separation import require_settable
from strandline.questions.compare.study_comparison import odds_in
from strandline.testing.studies import undeclared_beam, write_study

E = {"prior": {"uniform": [300, 560]}, "unit": "Pa"}
TILT = {"prior": {"uniform": [0.0, 0.08]}}
FREE = {"python": {"function": "strandline.testing.studies:undeclared_beam"}}
SMALL = {
    "inputs": {"E": E, "tilt": TILT},
    "observation": {"file": "../beam.csv", "unit": "mm"},
    "discrepancy": {"normal_offset": {}},
    "noise": {"sd": 3, "unit": "um"},
    "surrogate": {"field": {}},
}


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder with an observed interface, the same in the other direction, and another one."""
    points = undeclared_beam({"E": 400.0, "tilt": 0.02, "load": 1e-5}, Path()).interfaces[""].points
    for name, some in (
        ("beam", points),
        ("turned", points[::-1]),
        ("other", points + np.array([0, 0.01])),
        ("few", points[::2]),
    ):
        np.savetxt(tmp_path / f"{name}.csv", some, delimiter=",")
    return tmp_path


def study(home: Path, folder: str, **changes: Any) -> sl.Study:
    return sl.load_study(write_study(home / folder, **{**SMALL, "name": folder, **changes}))


def observed(name: str) -> dict[str, Any]:
    return {"observation": {"file": f"../{name}.csv", "unit": "mm"}}


def test_studies_that_can_be_compared(home: Path) -> None:
    """They know another input, allow for an error of the model, or observe the points in the other direction."""
    one, erring = study(home, "tilted"), {"noise": {"sd": 3, "unit": "um", "model_error": True}}
    assert not may_err(one)
    for changes in ({"inputs": {"E": E}, "fixed": {"load": 1e-5, "tilt": 0.015}}, erring, observed("turned")):
        other = study(home, "other", **changes)
        require_comparable({"tilted": one, "other": other})
        assert may_err(other) is (changes == erring)


REFUSED: list[tuple[dict[str, Any], str]] = [
    (
        {"noise": {"sd": "unknown", "unit": "um"}},
        "other cannot be compared: the range of its unknown noise is not",
    ),
    (observed("other"), r"the observed interfaces differ: got points up to 10 µm apart"),
    (observed("few"), "the observed interfaces differ: got another number of points"),
    (
        {"noise": {"sd": 4, "unit": "um"}},
        "tilted and other cannot be compared: the noise differs: got sd 0.003 ",
    ),
    ({"discrepancy": {"tracked_points": {}}}, "the measures differ: got NormalOffset and TrackedPoints"),
    (
        {"inputs": {"E": {**E, "prior": {"uniform": [300, 600]}}, "tilt": TILT}},
        r"the supports of the priors of E differ: got \[300, 560\] and \[300, 600\]",
    ),
    ({"model": FREE, "inputs": {"E": {**E, "unit": "kPa"}, "tilt": TILT}}, "the units of E differ: got Pa and kPa"),
]


def test_what_cannot_be_compared(home: Path) -> None:
    one = study(home, "tilted")
    for changes, words in REFUSED:
        with pytest.raises(InvalidStudy, match=words):
            require_comparable({"tilted": one, "other": study(home, "other", **changes)})
    fixed = {"load": 1e-5, "tilt": 0.015}
    stiffer = study(home, "other", inputs={"E": {**E, "prior": {"uniform": [300, 600]}}}, fixed=fixed)
    without = study(home, "straight", inputs={"tilt": TILT}, fixed={"load": 1e-5, "E": 400})
    with pytest.raises(InvalidStudy, match="tilted and stiffer cannot be compared: the supports"):
        require_comparable({"straight": without, "tilted": one, "stiffer": stiffer})


def test_synthetic_data_of_two_models_are_different_data(home: Path) -> None:
    """Each model makes its own."""
    one, other = study(home, "tilted"), study(home, "other", **observed("other"))
    with pytest.raises(InvalidStudy, match="A synthetic observation comes from the study's own model"):
        require_comparable({"tilted": one, "other": replace(other, truth={"E": 400.0})})
    with pytest.raises(InvalidStudy, match="they observe different conditions"):
        require_comparable({"tilted": one, "other": replace(other, observed={"a": one.observed[""]})})


def test_fewer_than_two_studies_are_refused(home: Path) -> None:
    one, other = study(home, "tilted"), study(home, "other")
    for studies, words in (
        ([], "got none; expected at least two study folders"),
        ([one], "tilted; expected at least two study folders"),
        (
            [one, other, replace(one, folder=home / "other" / ".." / "tilted")],
            "tilted twice; expected different fol",
        ),
    ):
        with pytest.raises(InvalidInput, match=words):
            require_several(studies)
    require_several([one, other])


def test_prior_odds(home: Path) -> None:
    assert odds_in(None) is None
    assert odds_in("2:1") == odds_in("2/1") == (2.0, 1.0)
    with pytest.raises(InvalidInput, match="prior odds of the models: got one; expected numbers above 0"):
        odds_in("one")
    studies = [study(home, "tilted"), study(home, "other")]
    for odds, words in (
        ((1.0, 0.0), "got 1:0; expected 2 numbers above 0"),
        ((1.0,), "got 1; expected 2 numbers above"),
    ):
        with pytest.raises(InvalidInput, match=words):
            sl.compare(studies, odds=odds)
    with pytest.raises(InvalidInput, match="seed of the comparison"):
        sl.compare(studies, seed=-1)


def test_names_of_studies(home: Path) -> None:
    a, b, c = (
        study(home, "a", name="beam"),
        study(home, "b", name="beam"),
        study(home, "c/a", name="other", **{"observation": {"file": str(home / "beam.csv"), "unit": "mm"}}),
    )
    assert labels_of([a, c]) == ("beam", "other")
    assert labels_of([a, b]) == ("a", "b")
    assert labels_of([a, b, c]) == tuple(str(one.folder.resolve()) for one in (a, b, c))


def test_candidates_must_fit_all_studies(home: Path) -> None:
    tilted, fixed = study(home, "tilted"), {"load": 1e-5, "tilt": 0.015}
    straight = study(home, "straight", inputs={"E": E}, fixed=fixed)
    for name, words in (("tilt", "which is calibrated there"), ("mass", "which its model does not have")):
        wanted, named = (Candidate(({name: 1.0},), Look()),), replace(straight, fixed={**fixed, "mass": 1.0})
        with pytest.raises(InvalidInput, match=f"do not fit tilted: got {name}, {words}"):
            require_settable({"straight": named, "tilted": tilted}, wanted)
