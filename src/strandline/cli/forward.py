"""`strandline forward`: one forward run at chosen inputs."""

import json
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
@click.option(
    "--set", "settings", multiple=True, metavar="NAME=VALUE", help="An input or fixed quantity; repeatable."
)
@click.option("--csv", "csv_path", type=click.Path(path_type=Path), help="Write the deformed interface, x,y in mm.")
@click.option("--json", "as_json", is_flag=True, help="Print the outcome as one JSON object.")
def command(study: Path, settings: tuple[str, ...], csv_path: Path | None, as_json: bool) -> None:
    """Make one forward run of STUDY's model; nothing goes into the ledger.

    Fixed quantities have the values of study.yaml unless set. A run that fails is an answer too: exit code 0 with
    --json, 1 without.
    """
    from strandline.studies import load_study
    from strandline.studies.build import check_values

    loaded = load_study(study)
    inputs = {**loaded.fixed, **_parsed(settings)}
    check_values(inputs, loaded.model, "--set")
    missing = [name for name in loaded.space.names if name not in inputs]
    if missing:
        raise InvalidInput(
            "inputs of the forward run",
            value=", ".join(settings) or None,
            expected=f"a value for {', '.join(missing)} too",
            remedy=f"Add --set {missing[0]}=VALUE.",
        )
    record = attempted(loaded.model, inputs)
    if csv_path is not None and record.interface is not None:
        _write_csv(csv_path, record)
    if as_json:
        click.echo(json.dumps(_outcome(record, inputs)))
        return
    if record.interface is None:
        click.echo(f"failed: {record.failure_kind or record.state}: {record.message}", err=True)
        raise SystemExit(1)
    figures = ", ".join(f"{name} {value:.6g}" for name, value in record.diagnostics.items())
    click.echo(f"ok in {record.seconds:.2f} s: {figures}")


def attempted(model: "ForwardModel", inputs: Mapping[str, float]) -> "RunRecord":
    """Return the record of one run in this process, in a temporary folder, with no ledger."""
    import tempfile

    from strandline.runs import RunRequest, attempt

    with tempfile.TemporaryDirectory(prefix="strandline-") as folder:
        return attempt(model, RunRequest("", dict(inputs)), Path(folder))


def _parsed(settings: tuple[str, ...]) -> dict[str, float]:
    values = {}
    for text in settings:
        name, separator, number = text.partition("=")
        try:
            if not separator:
                raise ValueError
            values[name.strip()] = float(number)
        except ValueError:
            raise InvalidInput(
                "--set", value=text, expected="NAME=NUMBER, e.g. E=400", remedy="Correct the option."
            ) from None
    return values


def _write_csv(path: Path, record: "RunRecord") -> None:
    assert record.interface is not None
    rows = "".join(f"{x!r},{y!r}\n" for x, y in record.interface.points.tolist())
    try:
        path.write_text("x,y\n" + rows, encoding="utf-8")
    except OSError as error:
        raise InvalidInput(
            "--csv", value=str(error), expected="a path that can be written", remedy="Choose another path."
        ) from None


def _outcome(record: "RunRecord", inputs: Mapping[str, float]) -> dict[str, object]:
    failure = None
    if record.interface is None:
        failure = {"state": record.state, "kind": record.failure_kind, "message": record.message}
    return {
        "inputs": dict(inputs),
        "state": record.state,
        "seconds": record.seconds,
        **dict(record.diagnostics),
        "failure": failure,
    }
