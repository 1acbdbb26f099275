"""`strandline forward`: one forward run at chosen inputs."""

import json
import math
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from typing import TYPE_CHECKING, Any

import click

from strandline.cli import options
from strandline.foundations import decimal, inputs_text
from strandline.studies import require_temporary, told_if_unwritable

if TYPE_CHECKING:
    import numpy as np

    from strandline.models import ForwardModel
    from strandline.runs import RunRecord

LOG_LINES = 20
SLOW = 10.0
"""Seconds after which a command says what it waits for."""


def _numbers(_context: click.Context, _option: click.Parameter, given: tuple[str, ...]) -> dict[str, float]:
    values: dict[str, float] = {}
    for text in given:
        name, _, number = (part.strip() for part in text.partition("="))
        value = decimal(number)
        if value is None or not math.isfinite(value):
            raise click.BadParameter(f"got {text}; expected NAME=NUMBER, such as E=400.")
        if name in values:
            raise click.BadParameter(f"got {name} for the second time; expected each name once.")
        values[name] = value
    return values


@click.command("forward")
@options.study
@options.repeatable("--set", "settings", "NAME=VALUE", "An input or fixed quantity; repeatable.", callback=_numbers)
@click.option("--csv", "csv_path", type=options.PATH, help="Write the deformed interface, x,y in mm.")
@options.as_json
@click.option("--sensitivities", is_flag=True, help="Add d(interface)/d(input) to the CSV and the JSON object.")
@click.option("--vtu", type=options.PATH, metavar="FOLDER", help="Write flow and deformation for ParaView.")
@click.option("--plot", is_flag=True, help="Draw forward.png: flow and deformation; in the folder of --vtu, or here.")
def command(
    study: Path,
    settings: dict[str, float],
    csv_path: Path | None,
    as_json: bool,
    sensitivities: bool,
    vtu: Path | None,
    plot: bool,
) -> None:
    """Make one forward run of STUDY's model; nothing goes into the ledger.

    Fixed quantities have the values of study.yaml unless set, coefficients of a field are 0. A run that fails is an
    answer too: exit code 0 with --json, 1 without; no CSV is written then. The search for its reason has no budget
    here, as it has in a campaign. A model of several conditions writes a file for each of them: with --csv shape.csv,
    shape-CONDITION.csv.
    """
    from strandline.models import declared_conditions, with_sensitivities, without_failure_budget
    from strandline.studies import check_complete, load_study

    loaded = load_study(study)
    coefficients = {one.name: 0.0 for one in loaded.space if one.of_field is not None}
    inputs = {**coefficients, **loaded.fixed, **settings}
    names = (*loaded.space.names, *loaded.fixed)
    check_complete(inputs, names, loaded.model, "--set", add="Add --set {name}=VALUE.")
    model = without_failure_budget(with_sensitivities(loaded.model) if sensitivities else loaded.model)
    targets: dict[str, Path] = {}
    if csv_path is not None:
        for condition in declared_conditions(model):
            name = f"{csv_path.stem}-{condition}{csv_path.suffix}"
            targets[condition] = csv_path.with_name(name) if condition else csv_path
            _require_target(targets[condition])
    if (vtu is not None or plot) and not hasattr(model, "fields"):
        raise click.UsageError(f"--vtu and --plot draw the `fields` of a model; {type(model).__name__} has none.")
    record = attempted(model, inputs)
    drawn = _write_fields(model, inputs, vtu, plot=plot) if record.ok and (vtu is not None or plot) else []
    if record.ok:
        for condition, path in targets.items():
            _write_csv(path, record, condition, sensitivities=sensitivities)
    if as_json:
        found = _outcome(record, inputs, targets) | {"written": [str(path) for path in drawn]}
        if sensitivities:
            every = record.sensitivities.items()
            found["sensitivities"] = {name: {key: one.tolist() for key, one in some.items()} for name, some in every}
        click.echo(json.dumps(found))
    elif not record.ok:
        message = (record.message or "").partition("\n")[0]
        click.echo(f"failed after {record.seconds:.2f} s: {record.failure_kind or record.state}: {message}", err=True)
        show_remains(record)
        raise SystemExit(1)
    else:
        figures = ", ".join(f"{name} {value:.6g}" for name, value in record.diagnostics.items())
        click.echo(f"ok in {record.seconds:.2f} s{': ' + figures if figures else ''}")
        for line in _told(record, model, sensitivities=sensitivities):
            click.echo(f"  {line}")
        for path in (*targets.values(), *drawn):
            click.echo(f"wrote {path}")


def show_remains(record: "RunRecord") -> None:
    """Print where the folder of a failed run is kept and how its log ends, if the simulator is a program."""
    from strandline.runs import told_folder

    if folder := told_folder(record):
        click.echo(f"{folder} (kept for a look; delete it at any time)", err=True)
    if record.log:
        lines = record.log.splitlines()[-LOG_LINES:]
        click.echo("\n".join(["last lines of the simulator's log:", *lines]), err=True)


@contextmanager
def told_if_slow(what: str, say: Callable[[str], None], timer: Callable[..., Timer] = Timer) -> Iterator[None]:
    """Say after `SLOW` seconds what the block still waits for; `timer` calls a function after some seconds."""
    told = (
        f"still waiting for {what}, {SLOW:g} s after its start; Ctrl-C ends it. A `timeout` of the executor or of a "
        "command in study.yaml, in seconds, lets `strandline run` end runs that hang."
    )
    waiting = timer(SLOW, say, [told])
    waiting.daemon = True
    waiting.start()
    try:
        yield
    finally:
        waiting.cancel()


def attempted(model: "ForwardModel", inputs: Mapping[str, float]) -> "RunRecord":
    """Return the record of one run in this process, in a temporary folder, with no ledger; if it is slow, say so."""
    from strandline.runs import RunRequest, attempt

    require_temporary()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # one solve is too small to benefit from threads
    what = f"the run at {inputs_text(inputs)}"
    with (
        tempfile.TemporaryDirectory(prefix="strandline-") as folder,
        told_if_slow(what, lambda text: click.echo(text, err=True)),
    ):
        return attempt(model, RunRequest("", dict(inputs)), Path(folder))


def _write_fields(model: Any, inputs: Mapping[str, float], folder: Path | None, *, plot: bool) -> list[Path]:
    """Write the solved state of each condition for ParaView and as a picture; return the paths."""
    from strandline.models import declared_conditions
    from strandline.models.biofilm import write_vtu
    from strandline.report import plot_flow

    written = []
    for condition in declared_conditions(model):
        fields = model.fields(inputs, condition) if condition else model.fields(inputs)
        if folder is not None:
            written.append(write_vtu(fields, folder / condition))
        if plot:
            target = (folder or Path()) / (f"forward-{condition}.png" if condition else "forward.png")
            _require_target(target)
            title = inputs_text(inputs)
            figure: Any = plot_flow(fields, title=f"{condition}: {title}" if condition else title)
            figure.savefig(target, dpi=160)
            written.append(target)
    return written


def _require_target(path: Path) -> None:
    """Refuse a path where no file can be created, before the run is made."""
    if path.is_dir():
        problem = "a folder"
    elif not path.parent.is_dir():
        problem = "in a folder that does not exist"
    elif not os.access(path if path.exists() else path.parent, os.W_OK):
        problem = "without write permission"
    else:
        return
    raise click.UsageError(f"{path} is {problem}; expected a file name in a folder that can be written to.")


def _told(record: "RunRecord", model: "ForwardModel", *, sensitivities: bool) -> Iterator[str]:
    """Yield a line for each named condition, and for each sensitivity with its largest value."""
    import numpy as np

    from strandline.models import declared_inputs

    units = {item.name: item.unit for item in declared_inputs(model)}
    for condition, interface in record.interfaces.items():
        if condition:
            yield f"{condition}: {len(interface.points)} points"
        for name, slope in record.sensitivities.get(condition, {}).items() if sensitivities else ():
            largest = float(np.linalg.norm(slope, axis=1).max())
            yield f"{condition + ': ' if condition else ''}d/d{name} up to {largest:.6g} mm{_per(units.get(name))}"


def _per(unit: str | None) -> str:
    """Return what follows mm in the unit of a derivative by an input of this unit."""
    if unit is None:
        return " per unit of the input"
    return "" if unit in ("", "1") else f" per {unit}"


def _write_csv(path: Path, record: "RunRecord", condition: str, *, sensitivities: bool) -> None:
    columns: dict[str, np.ndarray[Any, Any]] = {"x,y": record.interfaces[condition].points}
    if sensitivities:
        columns |= {f"dx_d{name},dy_d{name}": d for name, d in record.sensitivities[condition].items()}
    blocks = [block.tolist() for block in columns.values()]
    lines = [",".join(columns)] + [",".join(repr(v) for pair in row for v in pair) for row in zip(*blocks, strict=True)]
    with told_if_unwritable(path.parent):
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _outcome(record: "RunRecord", inputs: Mapping[str, float], targets: Mapping[str, Path]) -> dict[str, object]:
    failure = {"state": record.state, "kind": record.failure_kind, "message": record.message}
    figures = {name: value if math.isfinite(value) else None for name, value in record.diagnostics.items()}
    written = {condition: str(path) for condition, path in targets.items()} if record.ok else {}
    return {
        "inputs": dict(inputs),
        "state": record.state,
        "seconds": record.seconds,
        **figures,
        "csv": written.get("", written) or None,
        "failure": None if record.ok else failure,
    }
