"""Numbers, names, texts and sections of study.yaml: what could not be used later is refused, and unknown keys."""

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from strandline.foundations import decimal, is_label, is_name

MOST = 1_000_000
"""Largest count of runs, particles, workers and so on: more than anybody needs, and few enough for memory."""
MOST_RETRIES = 1000
MOST_VALUES = 10_000
"""Values of the nuisance inputs; the sampler runs once for each."""
VARIANCES = 1e-30, 1e30
"""Smallest and largest σ_N²; beyond them, likelihoods overflow."""


def _number(value: Any) -> Any:
    """Refuse true/false and text instead of a number; accept `1e-5`, which YAML 1.1 reads as text."""
    if isinstance(value, bool):
        raise ValueError("a number, not a truth value")
    if isinstance(value, str):
        number = decimal(value)
        if number is None:
            raise ValueError("a finite number" if value.strip(".+-").lower() in ("nan", "inf") else "a number")
        return number
    return value


def _whole(value: Any) -> Any:
    """Refuse true/false and text, even `"80"`, instead of a whole number."""
    if isinstance(value, bool):
        raise ValueError("a number, not a truth value")
    if isinstance(value, str):
        raise ValueError("a whole number, without quotes" if decimal(value) is not None else "a whole number")
    return value


def _name(value: str) -> str:
    if not is_name(value):
        raise ValueError("a short name on one line, without / \\ = $ and without blanks at its ends")
    return value


def _label(value: str) -> str:
    if not is_label(value):
        raise ValueError("a short text on one line without $, e.g. mm²/s")
    return value


Number = Annotated[float, BeforeValidator(_number), Field(allow_inf_nan=False)]
Whole = Annotated[int, BeforeValidator(_whole)]
Count = Annotated[Whole, Field(ge=1, le=MOST)]
Size = Annotated[Whole, Field(le=MOST)]
"""A count whose smallest value is checked elsewhere."""
Seed = Annotated[Whole, Field(ge=0, lt=2**32)]
Name = Annotated[str, AfterValidator(_name)]
Unit = Annotated[str, AfterValidator(_label)]
Text = Annotated[str, Field(strict=True, min_length=1)]


Choice = Annotated[dict[str, dict[str, Any] | None], Field(min_length=1, max_length=1)]
"""One named variant with its options: ``{currents: {width: 0.005}}``."""
Switch = Annotated[bool, Field(strict=True)]


class Section(BaseModel):
    """Keys with values."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)
