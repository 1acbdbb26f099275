"""Folders of SLURM batches, without SLURM."""

from pathlib import Path

import pytest

from strandline.runs.executors.slurm_batch import Batch, known_batches
from strandline.testing.executors import requests_for
from strandline.testing.models import Cantilever


def test_batches_are_listed_oldest_first(tmp_path: Path) -> None:
    made = [Batch.new(tmp_path, Cantilever(), requests_for(Cantilever()), None) for _ in range(3)]
    assert [batch.name for batch in known_batches(tmp_path)] == [batch.name for batch in made]


def test_a_batch_that_another_driver_removes_meanwhile_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = [Batch.new(tmp_path, Cantilever(), requests_for(Cantilever()), None) for _ in range(2)]
    read = Batch.read

    def remove_the_others_first(folder: Path) -> Batch:
        for batch in made:
            if batch.folder != folder:
                batch.remove()
        return read(folder)

    monkeypatch.setattr(Batch, "read", remove_the_others_first)
    assert len(list(known_batches(tmp_path))) == 1
