"""`make bench`: ``python -m benchmarks [inference|surrogate|norms|forward]``, all parts where none is named.

Each prints its figures and keeps them under its name in ``benchmarks/output/results.json``.
"""

import importlib
import json
import os
import sys
from pathlib import Path
from typing import Any

PARTS = ("inference", "surrogate", "norms", "forward")
OUTPUT = Path(__file__).parent / "output" / "results.json"


def main(arguments: list[str]) -> None:
    if not set(arguments) <= set(PARTS):
        sys.exit(f"usage: python -m benchmarks [{'|'.join(PARTS)}]")
    print(f"{os.cpu_count()} cores, OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'unset')}")
    for part in arguments or PARTS:
        print(f"\n{part}")
        save(OUTPUT, part, importlib.import_module(f"benchmarks.{part}").main())
    print(f"\nwritten: {OUTPUT}")


def save(output: Path, part: str, figures: list[dict[str, Any]]) -> None:
    """Write the figures of a part beside those of the others."""
    known = json.loads(output.read_text("utf-8")) if output.exists() else {}
    others = known if isinstance(known, dict) else {}
    output.parent.mkdir(exist_ok=True)
    output.write_text(json.dumps(others | {part: figures}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
