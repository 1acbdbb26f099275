"""`strandline doctor`: what is wrong with a study folder."""

from pathlib import Path

import click

from strandline.cli import options


@click.command("doctor")
@options.study
def command(study: Path) -> None:
    """Look for damage, gaps and drift in STUDY, and say what to do about each; change nothing.

    Exit code 0: sound; 1: something was found.
    """
    from strandline.studies.doctor import examine

    found = examine(study)
    for finding in found:
        click.echo(f"{finding.what}\n  -> {finding.remedy}")
    click.echo("sound: nothing found" if not found else f"{len(found)} found")
    if found:
        raise SystemExit(1)
