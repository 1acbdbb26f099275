"""Make the peers' environment, .venv in this folder: ``make bench-env``, part of `make bench`.

With the argument ``pyvbmc`` it makes .venv-pyvbmc for `verification.validation.pyvbmc`: ``make pyvbmc-env``. The
benchmark goes on without what cannot be installed. An environment whose lists have not changed is left as it is, unless
something was missing.
"""

import re
import subprocess
import sys
import venv
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
FOLDER = HERE / ".venv"
OWN: dict[str, tuple[Path, tuple[str, ...]]] = {
    "": (FOLDER, ("requirements.txt", "requirements-torch.txt")),
    "pyvbmc": (HERE / ".venv-pyvbmc", ("requirements-pyvbmc.txt",)),
}
"""Folder and lists of each environment, by the argument that selects it."""


def stamp(folder: Path) -> Path:
    """Return the file of an environment that says what was installed, if all could be."""
    return folder / "installed.txt"


def install(folder: Path, names: tuple[str, ...]) -> Iterator[str]:
    """Install each list; yield those that could not be installed, with pip's last message, without addresses."""
    content = "\n".join((HERE / name).read_text("utf-8") for name in names)
    if stamp(folder).exists() and stamp(folder).read_text("utf-8") == content:
        return
    venv.create(folder, with_pip=True)
    pip, complete = [folder / "bin" / "python", "-m", "pip", "install", "--quiet", "-r"], True
    for name in names:
        done = subprocess.run([*pip, HERE / name], capture_output=True, text=True)
        if done.returncode:
            complete = False
            yield f"{name}: " + re.sub(r"\S+://\S+|\(from [^)]*\)", "", done.stderr.strip().rpartition("\n")[2]).strip()
    if complete:
        stamp(folder).write_text(content, encoding="utf-8")


if __name__ == "__main__":
    for argument in sys.argv[1:] or [""]:
        for why in install(*OWN[argument]):
            print(f"not installed and not measured: {why}", file=sys.stderr)
