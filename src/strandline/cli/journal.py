"""The note on a ledger that has a rollback journal, printed once."""

import click

from strandline.studies import Study

__all__ = ["say_journal"]


def say_journal(study: Study, *, quiet: bool) -> None:
    """Print on standard error that the ledger of `study` has a rollback journal, and why.

    Raises:
        InvalidInput: The environment asks for an unknown kind of journal.
    """
    from strandline.runs.journal import note

    line = note(study.ledger_path)
    if line and not quiet:
        click.echo(line, err=True)
