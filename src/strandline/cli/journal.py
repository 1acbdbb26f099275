"""What is said, once, of a ledger on a network disk."""

import click

from strandline.studies import Study

__all__ = ["say_journal"]


def say_journal(study: Study, *, quiet: bool) -> None:
    """Say on standard error that the ledger of `study` has a rollback journal, and why.

    Raises:
        InvalidInput: the environment asks for a journal that there is not.
    """
    from strandline.runs.journal import note

    line = note(study.ledger_path)
    if line and not quiet:
        click.echo(line, err=True)
