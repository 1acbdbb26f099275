"""Check that what a user installs works: the wheel alone, in empty environments outside the checkout.

Builds the source distribution and the wheel, compares their files with those under version control, builds the wheel
from the source distribution too, and installs it without extras for the Python that runs this and for the newest one
on the machine. In each it makes a study, a few runs and a report, checks an example, and reads the posterior with ArviZ
as documented.

Run it with:  python -m verification.validation.installed
"""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import time
import zipfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from verification.validation.tables import ROOT, kept_or_scratch

STUDY = "studies/biofilm-uniform"
"""The same folder as in the documented programs."""
SMALL = {
    "design": "{sobol: {runs: 16}}",
    "surrogate": "{log_likelihood: {kernel: matern32}}",
    "sampler": "{smc: {particles: 200, rejuvenation_steps: 2, zeta: 0.5}}",
}
RESULTS = ("posterior.nc", "summary.json", "report.html", "figures/posterior.png", "figures/posterior.pdf")
LEFT_OUT = (".ci/",)
"""Folders under version control that the source distribution leaves out."""
ARVIZ = {0: "arviz>=0.21,<1", 1: "arviz>=1"}
ARVIZ_1_NEEDS = (3, 12)
OVERRIDE = "STRANDLINE_PYTHONS"
"""Environment variable that lists the interpreters to use instead, separated as in PATH."""
VERSION = "import sys, ensurepip, venv; print(sys.implementation.name, *sys.version_info[:4])"
LINK = re.compile(r"\]\((?!https?://)[^)]*\)")


class Failed(Exception):
    """A step has failed."""


class Interpreter(NamedTuple):
    """A Python that can make virtual environments, and its version."""

    version: tuple[int, ...]
    path: Path

    @property
    def name(self) -> str:
        return ".".join(map(str, self.version))


def interpreters() -> Sequence[Interpreter]:
    """Return one released CPython of each minor version, the newest first: on PATH, or installed by pyenv or uv."""
    if override := os.environ.get(OVERRIDE):
        candidates = {Path(item) for item in override.split(os.pathsep) if item}
    else:
        folders = [Path(item) for item in os.environ.get("PATH", "").split(os.pathsep) if item]
        folders += [*Path.home().glob(".pyenv/versions/*/bin"), *Path.home().glob(".local/share/uv/python/*/bin")]
        paths = (path for folder in folders for path in folder.glob("python3*"))
        candidates = {path for path in paths if re.fullmatch(r"python3(\.\d+)?", path.name)}
    newest_last = {one.version[:2]: one for one in sorted(filter(None, map(_asked, candidates)))}
    return list(newest_last.values())[::-1]


def _asked(path: Path) -> Interpreter | None:
    """Return the interpreter at a path; None if it does not run or is not suitable."""
    try:
        done = subprocess.run([path, "-c", VERSION], capture_output=True, text=True, timeout=30, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    kind, *version, level = done.stdout.split()
    return Interpreter(tuple(map(int, version)), path) if (kind, level) == ("cpython", "final") else None


def _require(condition: object, message: str) -> None:
    if not condition:
        raise Failed(message)


def command(*words: str | Path, folder: Path, **variables: str) -> str:
    """Run a command in `folder`, independent of this checkout's Python; return what it printed."""
    kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")}
    together = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run(words, cwd=folder, env=kept | variables, **together)
    shown = " ".join(map(str, words))
    _require(done.returncode == 0, f"exit code {done.returncode} of {shown}\n{done.stdout[-4000:]}")
    _require("Traceback" not in done.stdout, f"traceback of {shown}\n{done.stdout[-4000:]}")
    return done.stdout


def tracked() -> set[str]:
    """Return the files under version control."""
    listed = command("git", "ls-files", folder=ROOT).splitlines()
    return {name for name in listed if (ROOT / name).is_file()}


def wheel_files(wheel: Path) -> Mapping[str, bytes]:
    """Return the content of each file of a wheel except its list of checksums."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist() if not name.endswith("/RECORD")}


def compare_wheel(files: Mapping[str, bytes], known: set[str]) -> None:
    """Require a wheel to have exactly the package, its licence and its metadata, and no links that lead nowhere."""
    package = {name.removeprefix("src/") for name in known if name.startswith("src/")}
    package |= {f"strandline/{name}" for name in known if re.match("examples/[^/]+/", name)}
    (folder,) = {name.partition("/")[0] for name in files if ".dist-info/" in name}
    information = {"METADATA", "WHEEL", "entry_points.txt", "licenses/LICENSE", "licenses/NOTICE.md"}
    wanted = package | {f"{folder}/{name}" for name in information}
    _require(set(files) == wanted, f"files that differ in the wheel: {sorted(set(files) ^ wanted)}")
    _, _, description = files[f"{folder}/METADATA"].decode().partition("\n\n")
    _require(not LINK.findall(description), f"links of the long description: {LINK.findall(description)}")


def compare_sdist(sdist: Path, known: set[str]) -> None:
    """Require a source distribution to have exactly the files under version control."""
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = {name for name in known if not name.startswith(LEFT_OUT)} | {"PKG-INFO"}
    _require(names == wanted, f"files that differ in the source distribution: {sorted(names ^ wanted)}")


def build(folder: Path) -> Path:
    """Build both distributions, compare them with the checkout, and return the wheel."""
    command(sys.executable, "-m", "hatchling", "build", "-d", folder / "dist", folder=ROOT)
    (sdist,), (wheel,) = (folder / "dist").glob("*.tar.gz"), (folder / "dist").glob("*.whl")
    compare_sdist(sdist, tracked())
    compare_wheel(wheel_files(wheel), tracked())
    command(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", "from-sdist", sdist, folder=folder)
    same = wheel_files(folder / "from-sdist" / wheel.name) == wheel_files(wheel)
    _require(same, "the wheel built from the source distribution differs from the one built from the checkout")
    return wheel


def environment(python: Interpreter, wheel: Path, folder: Path) -> Path:
    """Return the folder of programs of a new environment with the wheel and its dependencies."""
    command(python.path, "-m", "venv", folder / "venv", folder=folder)
    programs = folder / "venv" / "bin"
    install(programs, str(wheel), folder)
    command(programs / "python", "-m", "pip", "check", folder=folder)
    where = command(programs / "python", "-c", "import strandline; print(strandline.__file__)", folder=folder)
    _require(Path(where.strip()).is_relative_to(folder), f"not the installed package: {where}")
    return programs


def install(programs: Path, what: str, folder: Path) -> None:
    """Install wheels only: not every user can install a package that must be compiled."""
    pip = (programs / "python", "-m", "pip", "install", "--quiet", "--only-binary", ":all:", "--no-compile")
    command(*pip, what, folder=folder)


def study(programs: Path, folder: Path) -> None:
    """Make a study and its runs, and its report a second time; and an example with its picture and its simulator."""
    home = {"XDG_CACHE_HOME": str(folder / "cache")}
    command(programs / "strandline", "init", STUDY, folder=folder)
    file = folder / STUDY / "study.yaml"
    text = file.read_text("utf-8")
    for key, value in SMALL.items():
        text, number = re.subn(rf"^{key}: .*$", f"{key}: {value}", text, flags=re.MULTILINE)
        _require(number == 1, f"no {key} in the study that init writes")
    file.write_text(text, "utf-8")
    for words in (("run", "--quiet", STUDY), ("report", "--quiet", STUDY)):
        printed = command(programs / "strandline", *words, folder=folder, **home)
        _require("report.html" in printed, f"no report named: {printed}")
        missing = [name for name in RESULTS if not (folder / STUDY / name).is_file()]
        _require(not missing, f"missing after {words[0]}: {missing}")
        shutil.rmtree(folder / STUDY / "figures")
    command(programs / "strandline", "init", "drop", "--example", "pendant-drop", folder=folder)
    printed = command(programs / "strandline", "check", "drop", folder=folder, **home)
    _require("study.yaml is sound" in printed, f"the check of the example: {printed}")


def arviz(python: Interpreter, programs: Path, folder: Path) -> str:
    """Read the posterior as the documentation says; return the version of ArviZ."""
    major = 1 if python.version >= ARVIZ_1_NEEDS else 0
    install(programs, ARVIZ[major], folder)
    page = (ROOT / "docs" / "how-to" / "results.md").read_text("utf-8")
    (documented,) = [text for text in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "import arviz" in text]
    program = f"{documented}print('version', az.__version__)\n"
    printed = command(programs / "python", "-W", "ignore", "-c", program, folder=folder)
    _require(re.search(r"^E +\d", printed, re.MULTILINE), f"no summary of E: {printed}")
    version = printed.rpartition("version ")[2].strip()
    _require(version.startswith(f"{major}."), f"ArviZ {version} instead of {ARVIZ[major]}")
    return version


def _job(python: Interpreter, wheel: Path, folder: Path) -> str:
    begun = time.monotonic()
    programs = environment(python, wheel, folder)
    study(programs, folder)
    version = arviz(python, programs, folder)
    return f"Python {python.name}: installed, study made, ArviZ {version}, in {time.monotonic() - begun:.0f} s"


def has_wheels(python: Interpreter, wheel: Path, folder: Path) -> bool:
    """Return whether each dependency has a wheel for a Python, and print it."""
    command(python.path, "-m", "venv", folder / python.name, folder=folder)
    pip = (folder / python.name / "bin" / "python", "-m", "pip", "install", "--quiet", "--dry-run")
    try:
        command(*pip, "--only-binary", ":all:", wheel, folder=folder)
    except Failed as failure:
        _require("No matching distribution" in str(failure), str(failure))
        print(f"Python {python.name}: {str(failure).strip().splitlines()[-1]}")
        return False
    print(f"Python {python.name}: every dependency has a wheel")
    return True


def _main() -> None:
    own = Interpreter(sys.version_info[:3], Path(sys.executable))
    newer = [p for p in interpreters() if p.version[:2] > own.version[:2]]
    with kept_or_scratch(None) as folder:
        wheel = build(folder)
        print(f"{wheel.name} has the files under version control, and is the same from the source distribution")
        newest = next((python for python in newer if has_wheels(python, wheel, folder)), None)
        chosen = [own, newest] if newest else [own]
        folders = [folder / f"job-{python.name}" for python in chosen]
        for each in folders:
            each.mkdir()
        with ThreadPoolExecutor(len(chosen)) as pool:
            for line in pool.map(_job, chosen, [wheel] * len(chosen), folders):
                print(line, flush=True)


if __name__ == "__main__":
    try:
        _main()
    except Failed as failure:
        sys.exit(f"validation.installed: {failure}")
