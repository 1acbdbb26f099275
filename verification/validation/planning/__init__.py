"""Planned experiments against the true model of the biofilm.

    python -m verification.validation.planning [gains] [advice] [unknown] [--truths 20] [--draws 1000] [--publish]

gains: expected information gains of twelve inflow rates and of their pairs against nested Monte Carlo with true runs.
advice: the widths after following the advice, against a second experiment at 50 mm²/s.
unknown: what a study of seven inputs is expected to leave unknown, against its posterior.

With ``--publish`` the tables go into docs/results/designs.md. All results are kept in output/planning.
"""
