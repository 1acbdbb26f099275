"""Arguments and options that several commands have."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from strandline.foundations import require

Decorated = TypeVar("Decorated", bound=Callable[..., Any])


class StudyFolder(click.Path):
    """A path whose completion suggests folders with a study.yaml; folders alone if none here begins like that."""

    name = "study"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the folders of studies that begin with what was typed."""
        head, _, start = incomplete.rpartition("/")
        shown = f"{head}/" if "/" in incomplete else ""
        try:
            folders = sorted(path for path in Path(shown or ".").iterdir() if path.name.startswith(start))
        except OSError:
            folders = []
        studies = [path.name for path in folders if (path / "study.yaml").is_file()]
        if studies:
            return [CompletionItem(f"{shown}{name}") for name in studies]
        return [CompletionItem(incomplete, type="dir")]


def repeatable(flag: str, name: str, metavar: str, meaning: str, **more: Any) -> Callable[[Decorated], Decorated]:
    """Return an option that may be given several times, for the argument `name`, a tuple."""
    return click.option(flag, name, multiple=True, metavar=metavar, help=meaning, **more)


STUDY, PATH = StudyFolder(path_type=Path), click.Path(path_type=Path)
UNIT = click.Choice(["mm", "um", "µm", "m"])
study = click.argument("study", type=STUDY)
quiet = click.option("--quiet", is_flag=True, help="Print only the result.")
seed = click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of all random numbers.")
measure = click.option("--measure", metavar="NAME", help="A measure of the study; its first by default.")
workers = click.option("--workers", type=click.IntRange(min=1), help="Worker processes, if not as study.yaml says.")
as_json = click.option("--json", "as_json", is_flag=True, help="Print everything as one JSON object.")
device = click.option(
    "--device", type=click.Choice(["cpu", "gpu"]), help="Where to sample; the CPU if JAX_PLATFORMS is not set."
)


def use_device(name: str | None) -> None:
    """Make JAX compute on a device, unless None, before anything imports it; refuse a device that it does not find."""
    if name is None:
        return
    os.environ["JAX_PLATFORMS"] = "cpu" if name == "cpu" else ""  # empty: the best device available
    import jax

    try:
        found = jax.devices(name)
    except RuntimeError:
        found = []
    expected = f"a device that JAX has; here it is {jax.default_backend()}"
    remedy = 'For an NVIDIA GPU: pip install "jax[cuda12]".' if name == "gpu" else "Leave the option out."
    require(found and jax.default_backend() == name, "--device", name, expected, remedy)
