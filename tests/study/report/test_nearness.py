"""A study whose observation lies elsewhere says so everywhere; one that runs the other way is turned round."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.study.conftest import Finished

from strandline.cli import main

Copies = Callable[[Finished], Path]


def observed_otherwise(folder: Path, points: np.ndarray, **changes: Any) -> dict[str, Any]:
    """Run a copied study again with these observed points, and return its summary; its runs are known already."""
    np.savetxt(folder / "observed.csv", points, delimiter=",")
    content = yaml.safe_load((folder / "study.yaml").read_text())
    content |= {"observation": {"file": "observed.csv", "unit": "mm"}, **changes}
    (folder / "study.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    main(["run", str(folder), "--quiet"])
    return dict(json.loads((folder / "summary.json").read_text("utf-8")))


def points_of(finished: Finished) -> np.ndarray:
    (seen,) = finished.outcome.calibration.problem.observations
    return np.asarray(seen.interface.points)


def test_an_observation_elsewhere_is_told_first(
    field: Finished, copy_of: Copies, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("strandline.report.page.figure_groups", lambda *_: {})
    assert field.outcome.summary["nearest"]["near"]
    assert "COMES NEAR" not in (field.folder / "report.html").read_text("utf-8")
    folder = copy_of(field)
    summary = observed_otherwise(folder, points_of(field) + np.array([50.0, 0.0]))["nearest"]
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("NOTHING IN THE BOX COMES NEAR")
    assert "Their centres lie 50 mm apart" in last
    assert (summary["near"], summary["message"]) == (False, last)
    page = (folder / "report.html").read_text("utf-8")
    first = page[page.index("for the result.</strong></p>") + 28 :].lstrip()
    assert page[page.index("</h1>") + 5 :].lstrip().startswith('<p class="warnings"><strong>A draft: ')
    assert first.startswith('<p class="warnings"><strong>NOTHING IN THE BOX COMES NEAR')


def test_a_reversed_contour_gives_the_same_posterior(
    beam: Finished, copy_of: Copies, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a model without an undeformed state: the runs say from which end it is run through."""
    found = observed_otherwise(copy_of(beam), points_of(beam)[::-1], report="none")
    assert "report: " not in capsys.readouterr().out
    assert found["set_aside"] == []
    assert any("were turned round" in line for line in found["warnings"])
    for symbol, values in beam.outcome.summary["inputs"].items():
        same = found["inputs"][symbol]
        assert (same["mean"], same["sd"]) == pytest.approx((values["mean"], values["sd"]), rel=1e-6)
