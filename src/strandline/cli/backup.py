"""`strandline backup`: a copy of a study's ledger."""

import sqlite3
from contextlib import closing
from pathlib import Path

import click

from strandline.cli import options
from strandline.errors import InvalidInput


@click.command("backup")
@options.study
@click.argument("file", type=click.Path(path_type=Path))
def command(study: Path, file: Path) -> None:
    """Copy the ledger of STUDY to FILE, which must not exist; it may be running meanwhile.

    To restore it, copy FILE to ledger.sqlite in the study folder while nothing is running there.
    """
    from strandline.runs.ledger_schema import copied, opened_for_reading
    from strandline.runs.overview import Overview
    from strandline.studies.folder import LEDGER

    if file.exists() or not file.parent.is_dir():
        raise InvalidInput(
            "FILE of the backup",
            value=str(file),
            expected="a file that does not exist, in a folder that does",
            remedy="Choose another name.",
        )
    with Overview(study / LEDGER) as ledger:
        number = len(ledger.runs())
    try:
        with closing(opened_for_reading(study / LEDGER)) as connection:
            copied(connection, file)
    except (OSError, sqlite3.Error) as error:
        raise InvalidInput(
            "FILE of the backup",
            value=f"{file}: {error}",
            expected="a folder that can be written to, with room on the disk, and a sound ledger",
            remedy="Choose another place; `strandline doctor` says whether the ledger is sound.",
        ) from error
    click.echo(f"wrote {file}: {number} runs")
