"""The posterior that the page shows: one that changes while it is being told is told whole."""

from pathlib import Path
from typing import Any

import pytest

import strandline as sl
from strandline.view import viewed as module
from strandline.view.assumptions import knobs_of
from strandline.view.viewed import ViewedStudy


def test_an_answer_is_of_one_posterior(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The posterior of fewer runs is ready while the earlier one is being told."""
    study = sl.load_study(folder)
    viewed = ViewedStudy(study)
    viewed.feed.update()
    viewed.newest.refresh(viewed.feed.succeeded)

    def meanwhile(*given: Any) -> Any:
        monkeypatch.setattr(module, "knobs_of", knobs_of)
        with study.runs.ledger() as ledger:
            ledger.exclude(study.runs.design_keys[3], "looks wrong")
        viewed.newest.refresh(viewed.feed.succeeded - 1)
        return knobs_of(*given)

    monkeypatch.setattr(module, "knobs_of", meanwhile)
    during, after = viewed.posterior, viewed.posterior
    for told, made in ((during, 1), (after, 2)):
        assert len(told["history"]) == made
        for name, one in told["history"][-1]["mean"].items():
            assert told["mean"][name] == pytest.approx(one, rel=1e-12)
