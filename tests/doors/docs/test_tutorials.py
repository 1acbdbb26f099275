"""Tutorials, and examples of the guides, are followed to the letter, and print what they show; the notebooks are run.

An example is what stands under a heading of a guide that begins with "Example". A study without ``version`` is the one
before it with other keys. ``…`` stands for what is left out.
"""

import itertools
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import pytest
import yaml

from strandline.cli.main import COMMANDS, command_named
from strandline.models.protocol import declared_conditions, undeformed_interface
from strandline.studies import load_study
from strandline.studies.keys.template import write_example

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
EXAMPLE = re.compile(r"^## Example.*?(?=^## |\Z)", re.DOTALL | re.MULTILINE)


def followed(page: str) -> str:
    """Return a tutorial, or the examples of a guide."""
    text = (DOCS / page).read_text("utf-8")
    return text if page.startswith("tutorials/") else "".join(EXAMPLE.findall(text))


PAGES = sorted(f"{folder}/{path.name}" for folder in ("how-to", "tutorials") for path in (DOCS / folder).glob("*.md"))
PAGES = [page for page in PAGES if followed(page)]
COMMAND = [sys.executable, "-c", "from strandline.cli import main; main()"]
NUMBER = r"(?<![\w.^])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
STEP = re.compile(
    r"^```(?P<language>yaml|console|python|text)\n(?P<block>.*?)^```$"
    r"|(?:^|(?<=\. ))Change `(?P<old>[^`]+)`\s+to\s+`(?P<new>[^`]+)`\s+in\s+`study.yaml`",
    re.DOTALL | re.MULTILINE,
)


class Step(NamedTuple):
    """One thing to do: a study to write, an edit of it, a command, or a program; and what it is said to print."""

    kind: str
    text: str
    shown: str = ""


def steps_of(page: str) -> Iterator[Step]:
    """Yield what a reader is told to do, in order."""
    program = ""
    for match in STEP.finditer(followed(page)):
        language, block = match["language"], match["block"]
        if language == "console":
            for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
                command, _, shown = part.partition("\n")
                assert command.startswith("strandline "), command
                yield Step("command", command, shown)
        elif language == "text":
            yield Step("program", program, block)
        elif language == "python":
            program = block
        elif language == "yaml":
            yield Step("study", block)
        else:
            yield Step("edit", match["old"], match["new"])


def with_examples(folder: Path) -> Path:
    """Copy the examples of the project into a folder, without what a run left there."""
    left = shutil.ignore_patterns("figures", "image", "runs", "__pycache__", "*.sqlite*", "*.json", "*.nc", "*.html")
    shutil.copytree(ROOT / "examples", folder / "examples", ignore=left)
    return folder


def changed(study: Path, step: Step, root: Path) -> Path:
    """Write the study of a step, or the last one with the keys of a step, or edit that one; return its folder."""
    if step.kind == "study":
        keys, text = yaml.safe_load(step.text), step.text
        if "version" not in keys:
            whole = yaml.safe_load((study / "study.yaml").read_text("utf-8")) | keys
            text = yaml.safe_dump(whole, allow_unicode=True, sort_keys=False)
        study = root / str(keys["name"])
        study.mkdir(exist_ok=True)
    else:
        text = (study / "study.yaml").read_text("utf-8")
        assert text.count(step.text) == 1, step.text
        text = text.replace(step.text, step.shown)
    (study / "study.yaml").write_text(text, encoding="utf-8")
    return study


ROW = rf"^ +[A-Za-z]\w*( +[A-Za-z]\S*)?( +{NUMBER}){{2}}"
RULES = (
    # mean, true mean, sd, true sd, shift, its error, ratio of the sd
    (rf"{ROW}.*±", lambda n: (*[0.3 * n[2]] * 4, 0.3, 0.1, 0.2)),
    # mean, sd, median, 5 %, 95 %, MAP, which is a single particle
    (ROW, lambda n: [share * n[1] for share in (0.3, 0.2, 0.3, 0.4, 0.4, 1.0)]),
    (r"^log-evidence", lambda n: (0.4, *(0.2 * value for value in n[1:]))),
    (r"^sampler against quadrature", lambda _: (0.05, 4.0)),
    (r"^Pareto k", lambda n: (0.3, 0.0, 0.0, 0.25 * n[-1])),
    (r"effective draws", lambda n: (*(0.0 for _ in n[:-1]), 0.4 * n[-1])),
    (r"^round \d+: off by", lambda n: (0.0, *(0.3 * value for value in n[1:]))),
    (r"alone .* with others", lambda _: (0.06, 0.08)),
    (r"log-evidence -", lambda _: (0.0, 0.5)),
    (r"^log-likelihood, true minus", lambda n: (0.3 * abs(n[0]) + 0.1, 0.3 * n[1])),
    (r"", lambda n: [0.1 * abs(value) for value in n]),
)
"""Tolerances of the figures of a line, by what the line is like; a tenth where nothing else fits."""
SPECIAL = ((r" s\b", float("inf")), (r"% of its mass", 1.0))
"""Tolerances of a figure by what follows it: seconds are nobody's promise."""


def compare(shown: str, printed: str) -> int:
    """Return how many figures of `shown` were compared with `printed`, in which its pieces must stand in order."""
    rest, compared = " ".join(printed.split()), 0
    for piece in shown.split("…"):
        words = " ".join(piece.split())
        if not words:
            continue
        match = re.search(f"({NUMBER})".join(map(re.escape, re.split(NUMBER, words))), rest)
        assert match, f"not printed: {words}\nin: {rest}"
        for (figure, tolerance, line), found in zip(figures(piece), match.groups(), strict=True):
            assert abs(float(found) - figure) <= tolerance, f"{found} printed, {figure:g} ± {tolerance:g} in: {line}"
            compared += 1
        rest = rest[match.end() :]
    return compared


def figures(piece: str) -> Iterator[tuple[float, float, str]]:
    """Yield each figure with its tolerance and its line."""
    for line in piece.splitlines():
        found = list(re.finditer(NUMBER, line))
        values = [float(match[0]) for match in found]
        rule = next(rule for pattern, rule in RULES if re.search(pattern, line))
        tolerances = rule(values) if values else ()
        for match, value, tolerance in zip(found, values, tolerances, strict=False):
            special = [t for pattern, t in SPECIAL if re.match(pattern, line[match.end() :])]
            last_place = 0.5 * 10.0 ** -len(match[0].partition(".")[2])
            yield value, max([tolerance, last_place, *special]), line


@pytest.mark.smoke
@pytest.mark.parametrize("page", PAGES)
def test_studies_and_commands_of_a_page_are_valid(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a forward run."""
    monkeypatch.chdir(with_examples(tmp_path))
    steps, study = list(steps_of(page)), Path()
    assert "command" in {step.kind for step in steps}
    for step in steps:
        if step.kind in {"study", "edit"}:
            study = changed(study, step, Path())
            load_study(study)
        elif step.kind == "command":
            folder = parsed(step)
            if step.text.startswith("strandline init"):
                example = step.text.partition("--example ")[2] or "biofilm"
                study = write_example(example, folder).parent
            if step.text.startswith("strandline forward") and "--csv" in step.text:
                # In place of the interfaces that the command would write.
                model, file = load_study(folder).model, Path(step.text.split("--csv ")[1].split()[0])
                for name in declared_conditions(model):
                    path = file.with_stem(f"{file.stem}-{name}") if name else file
                    np.savetxt(path, undeformed_interface(model).points, delimiter=",")
            assert (folder / "study.yaml").is_file(), f"{step.text}: no such study yet"
        else:
            compile(step.text, page, "exec")


def parsed(step: Step) -> Path:
    """Return the folder that a command is for, its options checked by the real command line."""
    _, name, *arguments = shlex.split(step.text)
    assert name in COMMANDS, step.text
    command = command_named(name)
    while isinstance(command, click.Group):
        name, *arguments = arguments
        command = command.commands[name]
    parameters = command.make_context(name, arguments).params
    several = parameters.get("studies") or (parameters.get("study") or parameters["folder"],)
    return Path(several[0])


SHOWN = """\
         E      Pa      397.9     21.97      396.8 …
        nu             0.2939   0.08735     0.2832      0.172     0.4242     0.2155
log-evidence -7.289; effective samples 1248
E1 alone 0.25, run for 3.0 s
"""
NOISE = {"397.9": "399.9", "0.2155": "0.2755", "3.0 s": "7.9 s"}
WRONG = {"397.9": "406.9", "0.172": "0.262", "0.2155": "0.3755", "-7.289": "7.289", "0.25": "0.29", "E1": "E2"}


def test_a_wrong_figure_or_word_is_noticed_and_the_noise_of_machines_is_not() -> None:
    same = SHOWN.replace("…", "365.7")
    for found, other in NOISE.items():
        assert compare(SHOWN, same.replace(found, other)) == 3 + 6 + 2 + 2
    for found, planted in WRONG.items():
        with pytest.raises(AssertionError):
            compare(SHOWN, same.replace(found, planted))


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_followed_and_shows_what_is_printed(page: str, tmp_path: Path) -> None:
    compared, study = 0, with_examples(tmp_path)
    for step in steps_of(page):
        if step.kind in {"study", "edit"}:
            study = changed(study, step, tmp_path)
        elif step.kind == "command":
            arguments = shlex.split(step.text)[1:]
            compared += compare(step.shown, printed([*COMMAND, *arguments], tmp_path))
            study = tmp_path / arguments[1] if arguments[0] == "init" else study
        else:
            compared += compare(step.shown, printed([sys.executable, "-c", step.text], tmp_path))
    assert compared >= 20
    for name in re.findall(r"`([\w-]+/[\w/-]+\.(?:png|html|json|nc))`", followed(page)):
        assert (tmp_path / name).is_file(), name


def printed(command: Sequence[str], folder: Path) -> str:
    """Return what `command` writes, and see that it succeeds."""
    env = {**os.environ, "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run(command, cwd=folder, env=env, timeout=1200, **both)
    assert done.returncode == 0, done.stdout
    return done.stdout


NOTEBOOKS = DOCS / "notebooks"
FOUND = {"own-simulator": {"E": 400.0}, "picture-to-posterior": {"gamma": 72.4, "b": 1.3}, "what-next": {"E": 400.0}}
"""True values of inputs, by notebook."""
SLOW = [pytest.param(name, marks=pytest.mark.long) for name in ("picture-to-posterior", "what-next")]


@pytest.mark.smoke
def test_every_notebook_is_known_and_kept_without_outputs() -> None:
    cells = {path.stem: json.loads(path.read_text("utf-8"))["cells"] for path in NOTEBOOKS.glob("*.ipynb")}
    assert set(cells) == set(FOUND)
    for one in itertools.chain(*cells.values()):
        assert (one.get("outputs", []), one.get("execution_count")) == ([], None)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", ["own-simulator", *SLOW])
def test_a_notebook_finds_the_truth(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.delenv("MPLBACKEND", raising=False)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    seen = [output["data"] for output in outputs if "data" in output]
    (line,) = (one["text/plain"] for one in seen if re.match("<(Calibration|Outcome)", one["text/plain"]))
    for inputs, truth in FOUND[name].items():
        found = re.search(rf"\b{inputs} = ([-\d.]+) ± ([\d.]+)", line.replace("\u00a0", " "))
        assert abs(float(found[1]) - truth) < 2.5 * float(found[2])
    assert {"image/png", "text/html"} <= {kind for one in seen for kind in one}
