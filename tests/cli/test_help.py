"""`--help` is quick because it loads no numerics."""

import subprocess
import sys

import pytest

from strandline import __version__
from strandline.cli.main import COMMANDS

HEAVY = {"numpy", "scipy", "jax", "matplotlib", "ngsolve", "netgen", "pydantic", "yaml", "rich", "xarray", "jinja2"}
PROBE = """
import sys
from strandline.cli import main
try:
    main(sys.argv[1:])
except SystemExit as ended:
    code = ended.code
else:
    code = 0
print("LOADED", code, *sorted({name.partition(".")[0] for name in sys.modules}))
"""


def loaded_by(*arguments: str) -> tuple[int, set[str], str]:
    """Return exit code, loaded top-level packages and output of a command line in a process of its own."""
    command = [sys.executable, "-c", PROBE, *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    shown, _, tail = ended.stdout.rpartition("LOADED ")
    code, *names = tail.split()
    return int(code), set(names), shown + ended.stderr


@pytest.mark.parametrize(
    "arguments",
    [(), *((name,) for name in COMMANDS), ("posterior", "check")],
    ids=["strandline", *COMMANDS, "posterior check"],
)
def test_help_loads_no_numerics(arguments: tuple[str, ...]) -> None:
    code, names, shown = loaded_by(*arguments, "--help")
    assert code == 0
    assert shown.startswith(f"Usage: strandline {' '.join(arguments)}".rstrip())
    assert names.isdisjoint(HEAVY)


def test_the_probe_sees_what_is_loaded(tmp_path: object) -> None:
    code, names, _ = loaded_by("check", str(tmp_path))
    assert code == 2
    assert {"numpy", "pydantic", "yaml"} <= names


def test_init_loads_no_numerics(tmp_path: object) -> None:
    code, names, _ = loaded_by("init", f"{tmp_path}/study")
    assert code == 0
    assert names.isdisjoint(HEAVY)


def test_help_names_every_command() -> None:
    _, _, shown = loaded_by("--help")
    for name, line in COMMANDS.items():
        assert f"  {name}" in shown
        assert line in shown


def test_version_and_no_command() -> None:
    assert loaded_by("--version")[2] == f"strandline, version {__version__}\n"
    code, _, shown = loaded_by()
    assert code == 2
    assert shown.startswith("Usage: strandline")
