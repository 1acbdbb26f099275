"""Tables of the reference pages that the code knows: ``python -m verification.reference_page`` writes them."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click
from verification.validation.tables import put_into_page, table

from strandline.cli.main import COMMANDS, command_named
from strandline.discrepancy import DISCREPANCIES
from strandline.foundations import lookup
from strandline.models import MODELS
from strandline.studies import StudyFile
from strandline.studies.keys.schema import PLAIN, Options, listed
from strandline.studies.keys.template import EXAMPLES

REFERENCE = Path(__file__).parents[1] / "docs" / "reference"


def pages() -> dict[str, str]:
    """Return the text of each page, by its name, with what the code says now."""
    keys: dict[str, Any] = {"key": {"": StudyFile}}
    for kind, of in {"model": MODELS, "measure": DISCREPANCIES}.items():
        options = {one: Options(lookup(of, one, kind), without=("sensitivities", "folder"), plain=PLAIN) for one in of}
        keys[kind] = {one: option.section for one, option in options.items()}
    study = [table(f"{kind}s", "", f"{kind} | default | meaning", _keys(of)) for kind, of in keys.items()]
    rows = {"command": _commands(), "example": ((f"`{name}`", what) for name, what in EXAMPLES.items())}
    command_line = [table(f"{what}s", "", f"{what} | meaning", some) for what, some in rows.items()]
    tables = {"study.md": study, "command-line.md": command_line}
    return {name: put_into_page((REFERENCE / name).read_text("utf-8"), some) for name, some in tables.items()}


def _keys(sections: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    for before, section in sections.items():
        for key in listed(section):
            default = f"`{key.default}`" if len(key.default) < 40 else "the study's"
            default = default.replace("`required`", "required").replace("``", "")
            name = f"{before}.{key.name}".removeprefix(".")
            if not name.startswith(("command.result", "command.success")):  # which the page describes
                yield f"`{name}`", default, key.meaning.replace("None", "`null`")


def _commands() -> Iterator[tuple[str, ...]]:
    for name in COMMANDS:
        found = command_named(name)
        for one in found.commands.values() if isinstance(found, click.Group) else [found]:
            context = click.Context(one, info_name=f"strandline {name}{'' if one is found else f' {one.name}'}")
            options = [p.get_help_record(context) for p in one.params if isinstance(p, click.Option)]
            usage = one.get_usage(context).removeprefix("Usage: ").replace(" [OPTIONS]", "")
            for left, right in ((f"**`{usage}`**", one.help), *((f"`{flag}`", said) for flag, said in options)):
                yield left.replace(" RANGE", "").replace("|", r"\|"), " ".join(right.split()).replace("|", r"\|")


if __name__ == "__main__":
    for page, text in pages().items():
        (REFERENCE / page).write_text(text, encoding="utf-8")
