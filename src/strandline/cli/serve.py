"""`strandline serve`, `view`: a study's model for other programs, by UM-Bridge, and a study in the browser."""

import signal
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from strandline.cli import options

if TYPE_CHECKING:
    from strandline.models.umbridge import UMBridgeServer
    from strandline.studies import Study


@click.command("serve")
@options.study
@click.option("--port", type=click.IntRange(0, 65535), default=4242, help="To listen on; 0 takes any free one. [4242]")
@click.option("--host", default="127.0.0.1", help="Address to listen on. [127.0.0.1, this machine alone]")
@click.option("--workers", type=click.IntRange(1), default=1, metavar="N", help="Runs made at the same time. [1]")
@click.option("--token", metavar="TEXT", envvar="STRANDLINE_TOKEN", help="Answer only requests that carry this secret.")
@options.repeatable("--allow-host", "names", "NAME", "A further name it is called by; repeatable.")
@options.repeatable("--allow-origin", "origins", "URL", "A web page that may ask; repeatable.")
@click.option("--outside", is_flag=True, help="Answer for inputs outside the boxes of the priors too.")
def serve(study: Path, port: int, host: str, workers: int, outside: bool, **access: Any) -> None:
    """Serve STUDY's model and its log-likelihood by UM-Bridge, until Ctrl-C; nothing goes into the ledger.

    `interface` takes the unknown inputs and yields the interface's points in mm, `log_likelihood` the log-likelihood
    of the study's observation by the true model. Requests of web pages are refused. Without --token every program that
    reaches the port can make runs; set it by the environment variable STRANDLINE_TOKEN where others see your processes.
    """
    from strandline.models.umbridge import Access, UMBridgeServer
    from strandline.studies import Solver, differentiating, load_study, plain_model, served_models

    door = Access.of(host, **access)
    loaded = load_study(study)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    plain, timeout = plain_model(loaded), getattr(loaded.executor, "timeout", None)
    models = [model for model in (plain, differentiating(plain)) if model is not None]  # the second with sensitivities
    solvers = [Solver(model, workers=workers, timeout=timeout) for model in models]
    try:
        with UMBridgeServer((), host, port, door=door) as server:
            server.models = served_models(loaded, *solvers, outside=outside)
            _announce(loaded, server, host)
            server.serve_forever()
    except KeyboardInterrupt:
        click.echo("stopped", err=True)
    finally:
        for solver in solvers:
            solver.close()


def _announce(study: "Study", server: "UMBridgeServer", host: str) -> None:
    from strandline.models import RUNS, KeepsFolders
    from strandline.models.umbridge import is_loopback

    if not is_loopback(host) and server.door.token is None:
        click.echo(f"warning: whoever reaches {host} over the network can make runs here", err=True)
    click.echo(f"{study.name}: serving {server.url}")
    inputs = groupby(study.space, key=lambda one: (one.of_field, "" if one.of_field else one.name))
    several = ([one.label() for one in some] for _, some in inputs)
    click.echo(f"  inputs: [{', '.join(' … '.join(dict.fromkeys((one[0], one[-1]))) for one in several)}]")
    kept = study.model.keep if isinstance(study.model, KeepsFolders) else "none"
    if kept != "none":
        click.echo(f"  folders of {'all' if kept == 'all' else 'failed'} runs are kept in {study.folder / RUNS}")
    for model in server.models:
        sizes = " and ".join(str(size) for size in model.output_sizes)
        features = ", ".join(name for name, offered in model.support.items() if offered)
        click.echo(f"  {model.name}: {sizes} number{'s' if sizes != '1' else ''}; {features}")


@click.command("view")
@options.study
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="To listen on; by default any free one.")
@click.option("--no-browser", is_flag=True, help="Print the address only.")
def view(study: Path, port: int, no_browser: bool) -> None:
    """Show STUDY in the browser, until Ctrl-C: runs, posterior, interfaces, and what its assumptions do.

    The page changes nothing in the study. It answers on this machine alone, to whoever has its address.
    """
    import webbrowser

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
