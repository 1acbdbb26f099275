"""Run the parts that are asked for, print their tables and publish them."""

import argparse
import json
from pathlib import Path

import verification.validation.planning as package
from verification.validation.planning.advice import table_of_advice
from verification.validation.planning.gains import table_of_gains
from verification.validation.planning.unknown import table_of_unknown
from verification.validation.tables import put_into_page

OUTPUT = Path(__file__).parents[1] / "output" / "planning"
PAGE = Path(__file__).parents[3] / "docs" / "results" / "designs.md"
PARTS = ("gains", "advice", "unknown")


def main() -> None:
    """Run the parts."""
    parser = argparse.ArgumentParser(description=package.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="part", help=f"some of {', '.join(PARTS)}; all by default")
    parser.add_argument("--truths", type=int, default=20)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--publish", action="store_true", help="put the tables into the page")
    options = parser.parse_args()
    unknown = set(options.parts) - set(PARTS)
    if unknown:
        parser.error(f"unknown part {', '.join(sorted(unknown))}; expected some of {', '.join(PARTS)}")
    OUTPUT.mkdir(parents=True, exist_ok=True)
    for part in options.parts or PARTS:
        if part == "gains":
            table, summary = table_of_gains(OUTPUT, draws=options.draws, processes=options.processes)
        elif part == "advice":
            table, summary = table_of_advice(OUTPUT, truths=options.truths)
        else:
            table, summary = table_of_unknown(OUTPUT)
        (OUTPUT / f"{part}.json").write_text(json.dumps({"table": table.as_json(), "summary": summary}, indent=1))
        print(table.markdown())
        print(json.dumps(summary, indent=1, ensure_ascii=False), flush=True)
        if options.publish:
            PAGE.write_text(put_into_page(PAGE.read_text("utf-8"), [table]), "utf-8")


if __name__ == "__main__":
    main()
