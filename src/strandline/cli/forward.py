"""`strandline forward`: one forward run at chosen inputs."""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from strandline.errors import InvalidInput

if TYPE_CHECKING:
    from strandline.models.protocol import ForwardModel
    from strandline.runs import RunRecord

__all__ = ["attempted", "command"]


@click.command("forward")
@click.argument("study", type=click.Path(path_type=Path))
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="An input or fixed quantity; repeatable.")
@click.option("--csv", "csv_path", type=click.Path(path_type=Path), help="Write the deformed interface, x,y in mm.")
@click.option("--json", "as_json", is_flag=True, help="Print the outcome as one JSON object.")
def command(study: Path, settings: tuple[str, ...], csv_path: Path | None, as_json: bool) -> None:
    """Make one forward run of STUDY's model; nothing goes into the ledger.

    Fixed quantities have the values of study.yaml unless set. A run that fails is an answer too: exit code 0 with
    --json, 1 without; no CSV is written then.
    """
    from strandline.studies import load_study
    from strandline.studies.build import check_complete

    loaded = load_study(study)
    inputs = {**loaded.fixed, **_parsed(settings)}
    names = (*loaded.space.names, *loaded.fixed)
    check_complete(inputs, names, loaded.model, "--set", add="Add --set {name}=VALUE.")
    if csv_path is not None:
        _require_target(csv_path)
    record = attempted(loaded.model, inputs)
    if csv_path is not None and record.interface is not None:
        _write_csv(csv_path, record)
    if as_json:
        click.echo(json.dumps(_outcome(record, inputs, csv_path)))
    elif record.interface is None:
        message = (record.message or "").partition("\n")[0]
        click.echo(f"failed after {record.seconds:.2f} s: {record.failure_kind or record.state}: {message}", err=True)
        raise SystemExit(1)
    else:
        figures = ", ".join(f"{name} {value:.6g}" for name, value in record.diagnostics.items())
        click.echo(f"ok in {record.seconds:.2f} s{': ' + figures if figures else ''}")


def attempted(model: "ForwardModel", inputs: Mapping[str, float]) -> "RunRecord":
    """Return the record of one run in this process, in a temporary folder, with no ledger."""
    import tempfile

    from strandline.runs import RunRequest, attempt

    with tempfile.TemporaryDirectory(prefix="strandline-") as folder:
        return attempt(model, RunRequest("", dict(inputs)), Path(folder))


def _parsed(settings: tuple[str, ...]) -> dict[str, float]:
    values = {}
    for text in settings:
        name, _, number = text.partition("=")
        try:
            values[name.strip()] = float(number)
        except ValueError:
            values[name.strip()] = math.nan
        if not math.isfinite(values[name.strip()]):
            raise InvalidInput(
                "--set",
                value=text,
                expected="NAME=NUMBER, e.g. E=400",
                remedy="Correct the option.",
            )
    return values


def _require_target(path: Path) -> None:
    """Refuse a place where the file cannot be made, before the run is."""
    if path.is_dir():
        problem = "a folder"
    elif not path.parent.is_dir():
        problem = "in a folder that does not exist"
    elif not os.access(path if path.exists() else path.parent, os.W_OK):
        problem = "without write permission"
    else:
        return
    raise _unwritable(f"{path}, {problem}")


def _write_csv(path: Path, record: "RunRecord") -> None:
    assert record.interface is not None
    rows = "".join(f"{x!r},{y!r}\n" for x, y in record.interface.points.tolist())
    try:
        path.write_text("x,y\n" + rows, encoding="utf-8")
    except OSError as error:
        raise _unwritable(f"{path}: {error.strerror}") from None


def _unwritable(value: str) -> InvalidInput:
    return InvalidInput(
        "--csv", value=value, expected="a file name in a folder that can be written to", remedy="Choose another path."
    )


def _outcome(record: "RunRecord", inputs: Mapping[str, float], csv_path: Path | None) -> dict[str, object]:
    failure = None
    if record.interface is None:
        failure = {"state": record.state, "kind": record.failure_kind, "message": record.message}
    figures = {name: value if math.isfinite(value) else None for name, value in record.diagnostics.items()}
    return {
        "inputs": dict(inputs),
        "state": record.state,
        "seconds": record.seconds,
        **figures,
        "csv": None if csv_path is None or failure else str(csv_path),
        "failure": failure,
    }
