"""`strandline view`: a study in the browser, while its runs are made and after."""

import webbrowser
from pathlib import Path

import click

from strandline.cli import options


@click.command("view")
@options.study
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="To listen on; by default any free one.")
@click.option("--no-browser", is_flag=True, help="Print the address only.")
def command(study: Path, port: int, no_browser: bool) -> None:
    """Show STUDY in the browser, until Ctrl-C: runs, posterior, interfaces, and what its assumptions do.

    The page changes nothing in the study. It answers on this machine alone, to whoever has its address.
    """
    from strandline.studies import load_study
    from strandline.view import Server

    server = Server(load_study(study), port=port)

    def started() -> None:
        click.echo(f"{study}: {server.url}")
        click.echo(f"Ctrl-C ends. From another machine: ssh -L {server.port}:localhost:{server.port} THIS_MACHINE")
        if not no_browser:
            webbrowser.open(server.url)

    try:
        server.run(started)
    except KeyboardInterrupt:
        click.echo("stopped", err=True)
