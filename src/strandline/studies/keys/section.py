"""What all sections of study.yaml have in common: unknown keys are refused, and docstrings say what each key means."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

__all__ = ["Choice", "Section", "Switch"]

Choice = Annotated[dict[str, dict[str, Any] | None], Field(min_length=1, max_length=1)]
"""One named variant with its options: ``{currents: {width: 0.005}}``."""
Switch = Annotated[bool, Field(strict=True)]


class Section(BaseModel):
    """Keys with values."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)
