"""Sections made from classes: names, types and defaults are those of the class."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import pytest
from pydantic import ValidationError

from strandline.studies.keys import keys_within
from strandline.studies.keys.listed import Key, listed
from strandline.studies.keys.options import Options, meanings
from strandline.studies.keys.scalars import Count
from strandline.studies.keys.section import Section


@dataclass(frozen=True)
class Oven:
    """Bakes.

    Args:
        heat: Temperature, °C.
        minutes: How long,
            in minutes.
        shelf: ``upper`` or ``lower``.
        tins: Names of tins.
        fan: Whether the fan is on.
    """

    heat: float
    minutes: int = 45
    shelf: str | None = None
    tins: tuple[str, ...] = ()
    fan: bool = False
    serial: str = field(default="1", init=False)


class Kitchen(Section):
    """A kitchen."""

    oven: Annotated[Mapping[str, Any], Options(Oven, without=("fan",), also={"ovens": (Count, 1)})] | None = None


def test_keys_have_the_types_and_defaults_of_the_class() -> None:
    found = Kitchen.model_validate({"oven": {"heat": 200, "tins": ["round"]}}).oven
    assert found == {"heat": 200.0, "minutes": 45, "tins": ["round"], "ovens": 1}
    assert Oven(**{name: found[name] for name in ("heat", "minutes")}) == Oven(200.0)


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({}, "heat"),
    ({"heat": "hot"}, "heat"),
    ({"heat": True}, "heat"),
    ({"heat": 200, "minutes": 1.5}, "minutes"),
    ({"heat": 200, "minutes": 10**9}, "minutes"),
    ({"heat": 200, "shelf": 3}, "shelf"),
    ({"heat": 200, "tins": [3]}, "tins"),
    ({"heat": 200, "fan": True}, "fan"),
    ({"heat": 200, "serial": "2"}, "serial"),
    ({"heat": 200, "ovens": 0}, "ovens"),
]


def test_other_values_are_refused() -> None:
    for given, place in REFUSED:
        with pytest.raises(ValidationError) as caught:
            Kitchen.model_validate({"oven": given})
        assert caught.value.errors()[0]["loc"][:2] == ("oven", place)
    # An option that is null is left to the class.
    assert "minutes" not in (Kitchen.model_validate({"oven": {"heat": 200, "minutes": None}}).oven or {})


def test_meanings_are_those_of_the_docstring() -> None:
    assert meanings(Oven)["minutes"] == "How long, in minutes."
    assert set(meanings(Oven)) == {"heat", "minutes", "shelf", "tins", "fan"}


def test_keys_are_listed_with_defaults_and_meanings() -> None:
    assert listed(Kitchen)[:2] == (
        Key("oven.heat", "required", "Temperature, °C"),
        Key("oven.minutes", "45", "How long, in minutes"),
    )
    assert [key.default for key in listed(Kitchen)[2:]] == ["null", "[]", "1"]


def test_the_section_inside_an_annotation_is_found() -> None:
    section = keys_within(Kitchen.model_fields["oven"].annotation)
    assert section is not None
    assert set(section.model_fields) == {"heat", "minutes", "shelf", "tins", "ovens"}
    assert keys_within(dict[str, float]) is None
