"""A model with a cheaper one beside it."""

import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.models.fidelities import CHEAPER, FIRST_PAIRS, WithCheaper, by_cheaper, first_runs, run_identity
from strandline.models.protocol import Simulation, declared_conditions, fingerprint


@dataclass(frozen=True)
class Rod:
    """A straight rod whose number of nodes is its fidelity."""

    nodes: int = 9
    conditions: tuple[str, ...] = ("",)

    @property
    def fingerprint(self) -> str:
        return f"rod:{self.nodes}"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        assert set(inputs) == {"slope"}
        x = np.linspace(0.0, 1.0, self.nodes)
        return Simulation.of(Interface.polyline(np.stack([x, inputs["slope"] * x], axis=1)))

    def undeformed(self) -> str:
        return f"{self.nodes} nodes"


def test_a_mark_chooses_the_cheaper_model_and_its_address() -> None:
    both, plain, marked = WithCheaper(Rod(9), Rod(3), 0.2), {"slope": 1.0}, by_cheaper({"slope": 1.0})
    assert len(both(plain, Path()).interface.points) == 9  # type: ignore[union-attr]
    assert len(both(marked, Path()).interface.points) == 3  # type: ignore[union-attr]
    assert fingerprint(both) == fingerprint(Rod(9))
    assert run_identity(both, "rod:9", plain) == "rod:9"
    assert run_identity(both, "rod:9", marked) == "rod:3"
    assert run_identity(Rod(9), "rod:9", marked) == "rod:9"


def test_it_offers_what_the_model_offers_and_can_be_pickled() -> None:
    both = pickle.loads(pickle.dumps(WithCheaper(Rod(9), Rod(3), 0.2)))
    assert both.undeformed() == "9 nodes"
    assert declared_conditions(both) == ("",)
    with pytest.raises(AttributeError, match="on_finer_mesh"):
        both.on_finer_mesh({})


def test_a_first_design_runs_both_models_at_some_inputs() -> None:
    inputs = [{"slope": float(k)} for k in range(5)]
    assert first_runs(Rod(), inputs) == inputs
    found = first_runs(WithCheaper(Rod(9), Rod(3), 0.2), inputs)
    assert [CHEAPER in one for one in found] == [True] * 5 + [False] * FIRST_PAIRS
    assert found[5:] == inputs[:FIRST_PAIRS]


@pytest.mark.parametrize(
    ("cheaper", "cost", "message"),
    [
        (Rod(9), 0.2, "the model itself"),
        (Rod(3), 1.0, "above 0 and below 1"),
        (Rod(3), 0.0, "above 0 and below 1"),
        (Rod(3, ("a",)), 0.2, "conditions of the cheaper model: got a; expected those of the model"),
    ],
)
def test_what_does_not_fit_is_refused(cheaper: Any, cost: float, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        WithCheaper(Rod(9), cheaper, cost)
