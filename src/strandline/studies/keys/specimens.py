"""The key `specimens` of study.yaml: many outlines that the runs of the study answer together."""

from typing import Annotated, Any

from pydantic import Field, model_validator

from strandline.studies.keys.section import Section

__all__ = ["SpecimensFile"]


class SpecimensFile(Section):
    """Outlines of many specimens."""

    files: Annotated[str, Field(min_length=1)]
    """files of the outlines, or pictures of them, relative to the study folder: `specimens/*.csv`; or this alone,
    `specimens: specimens/*.csv`"""
    given: str | None = None
    """a table of [known inputs](../how-to/many-specimens.md#known-inputs): a column `file` and one for each of them"""
    read: dict[str, Any] | None = None
    """how to read the files, with the keys of `observation`: `{unit: mm}`, or `{image: {…}}` for pictures; default: as
    `observation`"""

    @model_validator(mode="before")
    @classmethod
    def _files_alone(cls, given: Any) -> Any:
        return {"files": given} if isinstance(given, str) else given
