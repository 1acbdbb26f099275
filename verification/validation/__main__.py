"""All verifications of the forward model; they take a few minutes on one core.

Writes verification/validation/output/verification.md and .json. With ``--publish`` the tables also go into the page
docs/results/forward-model.md, their raw numbers into verification.json next to it, and the figures are drawn again.

Run it with:  python -m verification.validation [--publish]
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from verification.validation import analytic, biofilm_mesh, extremes, figures, generality, sensitivities, turek_hron
from verification.validation.tables import Table, put_into_page

OUTPUT = Path(__file__).parent / "output"
PAGE = Path(__file__).parents[2] / "docs" / "results" / "forward-model.md"
PARTS = (turek_hron, analytic, biofilm_mesh, sensitivities, extremes, generality)


def write(tables: Sequence[Table], folder: Path) -> str:
    """Write verification.md and verification.json; return the text of verification.json."""
    folder.mkdir(exist_ok=True)
    text = "\n".join(f"## {table.title}\n\n{table.markdown()}\n" for table in tables)
    raw = json.dumps({table.name: table.as_json() for table in tables}, indent=1, ensure_ascii=False) + "\n"
    (folder / "verification.md").write_text(f"# Verification of the forward model\n\n{text}", "utf-8")
    (folder / "verification.json").write_text(raw, "utf-8")
    return raw


def publish(tables: Sequence[Table], raw: str) -> None:
    """Put tables and figures into the documentation."""
    PAGE.with_name("verification.json").write_text(raw, "utf-8")
    PAGE.write_text(put_into_page(PAGE.read_text("utf-8"), tables), "utf-8")
    figures.draw(tables, PAGE.parents[1] / "figures")


def main(arguments: Sequence[str]) -> None:
    """Run everything; see the module's docstring."""
    tables: list[Table] = []
    for part in PARTS:
        tables += part.tables()
        print(f"{part.__name__} done", flush=True)
    raw = write(tables, OUTPUT)
    if "--publish" in arguments:
        publish(tables, raw)


if __name__ == "__main__":
    main(sys.argv[1:])
