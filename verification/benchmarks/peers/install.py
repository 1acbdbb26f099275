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
from pathlib import Path

HERE = Path(__file__).parent
FOLDER = HERE / ".venv"
OWN: dict[str, tuple[Path, tuple[str, ...]]] = {
    "": (FOLDER, ("requirements.txt", "requirements-torch.txt")),
    "pyvbmc": (HERE / ".venv-pyvbmc", ("requirements-pyvbmc.txt",)),
}
"""Folder and lists of each environment, by the argument that selects it."""
NOTE = "not-installed.json"


def install(folder: Path, names: tuple[str, ...]) -> dict[str, str]:
    """Install each list; return those that could not be installed, with the reason."""
    stamp, content = folder / "installed.txt", "\n".join((HERE / name).read_text("utf-8") for name in names)
    if stamp.exists() and stamp.read_text("utf-8") == content:
        return {}
    try:
        venv.create(folder, with_pip=True)
    except (OSError, subprocess.CalledProcessError) as error:
        return dict.fromkeys(names, f"no environment could be made: {error}")
    missing, pip = {}, [folder / "bin" / "python", "-m", "pip", "install", "--quiet", "-r"]
    for name in names:
        done = subprocess.run([*pip, HERE / name], capture_output=True, text=True)
        if done.returncode:
            missing[name] = reason(done.stderr)
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


if __name__ == "__main__":
    for argument in sys.argv[1:] or [""]:
        for name, why in install(*OWN[argument]).items():
            print(f"benchmarks: the peers of {name} are not measured: {why}", file=sys.stderr)
