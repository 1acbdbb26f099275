"""Make the peers' environment, .venv in this folder: ``make bench-env``, part of `make bench`.

With the argument ``pyvbmc`` it makes .venv-pyvbmc for `verification.validation.pyvbmc`: ``make pyvbmc-env``.

What cannot be installed is printed and noted in ``.venv/not-installed.json`` for the benchmark, which goes on without
it. An environment whose lists have not changed is left as it is, unless something was missing.
"""

import json
import re
import subprocess
import sys
import venv
from collections.abc import Callable, Sequence
from pathlib import Path

HERE = Path(__file__).parent
FOLDER = HERE / ".venv"
LISTS = ("requirements.txt", "requirements-torch.txt")
OWN: dict[str, tuple[Path, tuple[str, ...]]] = {"pyvbmc": (HERE / ".venv-pyvbmc", ("requirements-pyvbmc.txt",))}
"""Folder and lists of each further environment, by the argument that selects it."""
NOTE = "not-installed.json"

Runner = Callable[[Sequence[str]], "subprocess.CompletedProcess[str]"]


def run(command: Sequence[str]) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(command, capture_output=True, text=True)


def install(folder: Path = FOLDER, *, lists: Sequence[Path] | None = None, runner: Runner = run) -> dict[str, str]:
    """Install each list; return those that could not be installed, with the reason."""
    wanted = [HERE / name for name in LISTS] if lists is None else lists
    stamp, content = folder / "installed.txt", "\n".join(one.read_text("utf-8") for one in wanted)
    if stamp.exists() and stamp.read_text("utf-8") == content:
        return {}
    try:
        venv.create(folder, with_pip=True)
    except (OSError, subprocess.CalledProcessError) as error:
        return {one.name: f"no environment could be made: {error}" for one in wanted}
    missing = {}
    for one in wanted:
        done = runner([str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet", "-r", str(one)])
        if done.returncode:
            missing[one.name] = reason(done.stderr)
    (folder / NOTE).write_text(json.dumps(missing), encoding="utf-8")
    if not missing:
        stamp.write_text(content, encoding="utf-8")
    return missing


def reason(complaints: str) -> str:
    """Return pip's last message, without addresses."""
    errors = [line for line in complaints.splitlines() if line.startswith("ERROR")] or complaints.splitlines()
    return re.sub(r"\S+://\S+|\(from [^)]*\)", "", errors[-1] if errors else "pip ended without a word").strip()


def not_installed(folder: Path = FOLDER) -> str:
    """Return what could not be installed and why, or nothing."""
    note = folder / NOTE
    missing = json.loads(note.read_text("utf-8")) if note.exists() else {}
    return "; ".join(f"{name}: {why}" for name, why in missing.items())


def main(arguments: Sequence[str]) -> None:
    """Install the peers of `make bench`, or those of the arguments in `OWN`, and print what is missing."""
    for folder, names in [OWN[name] for name in arguments] if arguments else [(FOLDER, LISTS)]:
        for name, why in install(folder, lists=[HERE / one for one in names]).items():
            print(f"benchmarks: the peers of {name} are not measured: {why}", file=sys.stderr)


if __name__ == "__main__":
    main(sys.argv[1:])
