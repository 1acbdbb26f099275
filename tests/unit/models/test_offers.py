"""What a model may offer beside its runs, and an offer that is none."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.models.offers import KeepsFolders, SolvesOnFinerMesh, undeformed_interface
from strandline.models.protocol import fingerprint

LINE = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0]]))


class Plain:
    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Interface:
        return LINE


class Whole(Plain):
    def undeformed(self) -> Interface:
        return LINE


class Attribute(Plain):
    undeformed = LINE


class Points(Plain):
    def undeformed(self) -> Any:
        return LINE.points


def test_the_undeformed_interface_is_given_lacking_or_refused() -> None:
    assert undeformed_interface(Whole()) is LINE
    assert undeformed_interface(Plain()) is None
    assert not isinstance(Plain(), SolvesOnFinerMesh | KeepsFolders)
    for wrong, said in ((Attribute(), "got an attribute"), (Points(), "got a ndarray")):
        with pytest.raises(InvalidInput, match=said):
            undeformed_interface(wrong)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Labelled(Plain):
    nodes: int = 41
    sensitivities: bool = False
    fingerprint = "mine-1"


@dataclass(frozen=True)
class Declared(Plain):
    nodes: int = 41
    fingerprint: ClassVar[str] = "mine-1"


@dataclass(frozen=True)
class Own(Plain):
    nodes: int = 41

    @property
    def fingerprint(self) -> str:
        return "mine-1"


def test_options_count_where_a_class_states_one_fingerprint_for_all() -> None:
    assert fingerprint(Labelled()) == fingerprint(Labelled(sensitivities=True)) == "mine-1"
    assert fingerprint(Labelled(5)) == 'mine-1/{"nodes": 5}'
    assert fingerprint(Own(5)) == fingerprint(Own()) == "mine-1"
    assert fingerprint(Declared(5)) == fingerprint(Declared()) == "mine-1"
