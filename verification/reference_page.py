"""The table of the keys of study.yaml on its reference page: ``python -m verification.reference_page`` writes it."""

from pathlib import Path

from verification.validation.tables import Table, put_into_page

from strandline.studies.keys import StudyFile
from strandline.studies.keys.schema import listed

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "study.md"


def page() -> str:
    """Return the text of the page with the present keys."""
    rows = tuple((f"`{key.name}`", _default(key.default), key.meaning) for key in listed(StudyFile))
    table = Table("keys", "Keys of study.yaml", ("key", "default", "meaning"), ("s", "s", "s"), rows)
    return put_into_page(PAGE.read_text("utf-8"), [table])


def _default(text: str) -> str:
    return text if text == "required" else f"`{text}`"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
