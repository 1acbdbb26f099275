"""A worker process that is replaced when it is killed while it starts."""

import contextlib
from pathlib import Path

import pytest

from strandline.errors import InvalidInput
from strandline.runs.on_call import OnCall
from strandline.testing.executors import requests_for
from strandline.testing.models import KilledWhileLoading


def test_a_worker_killed_while_it_loads_is_replaced(tmp_path: Path) -> None:
    model = KilledWhileLoading(str(tmp_path), times=3)
    with contextlib.closing(OnCall(model)) as on_call:
        assert on_call(requests_for(model)[0]).ok
    assert len(list(tmp_path.iterdir())) == 3


def test_workers_killed_at_every_start_are_one_clear_error(tmp_path: Path) -> None:
    model = KilledWhileLoading(str(tmp_path), times=100)
    with (
        contextlib.closing(OnCall(model)) as on_call,
        pytest.raises(InvalidInput, match="killed before they have loaded the model"),
    ):
        on_call(requests_for(model)[0])
    assert len(list(tmp_path.iterdir())) == 11
