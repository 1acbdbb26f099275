"""Planned experiments against the true model of the biofilm.

    python -m verification.validation.planning [gains] [advice] [unknown] [--truths 20] [--draws 1000] [--publish]

gains: expected information gains of twelve inflow rates and of their pairs against nested Monte Carlo with true runs.
advice: the widths after following the advice, against a second experiment at 50 mm²/s.
unknown: what a study of seven inputs is expected to leave unknown, against its posterior.

With ``--publish`` the tables go into docs/results/designs.md. All results are kept in output/planning.
"""

from verification.validation.planning.advice import table_of_advice
from verification.validation.planning.gains import table_of_gains
from verification.validation.planning.unknown import table_of_unknown
from verification.validation.tables import DOCS, OUTPUT, arguments, as_text, show

PAGE = DOCS / "results" / "designs.md"
PARTS = {
    "gains": lambda folder, options: table_of_gains(folder, options.draws, options.processes),
    "advice": lambda folder, options: table_of_advice(folder, options.truths),
    "unknown": lambda folder, options: table_of_unknown(folder),
}

if __name__ == "__main__":
    options, folder = (
        arguments(__doc__, words=PARTS, truths=20, draws=1000, processes=2, publish=False),
        OUTPUT / "planning",
    )
    folder.mkdir(parents=True, exist_ok=True)
    for part in options.words or PARTS:
        table, summary = PARTS[part](folder, options)
        (folder / f"{part}.json").write_text(as_text({"table": table.as_json(), "summary": summary}), "utf-8")
        show([table], page=PAGE if options.publish else None)
        print(as_text(summary), flush=True)
