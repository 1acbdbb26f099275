"""`strandline init`: a commented study folder that runs."""

from pathlib import Path

import click

__all__ = ["command"]


@click.command("init")
@click.argument("folder", type=click.Path(path_type=Path))
def command(folder: Path) -> None:
    """Write FOLDER/study.yaml, a commented study that runs as it is (a biofilm, at most 80 forward runs)."""
    import shlex

    from strandline.studies.template import write_template

    path = write_template(folder)
    name = shlex.quote(str(folder))
    click.echo(f"wrote {path}\nnext: strandline check {name}, then strandline run {name}")
