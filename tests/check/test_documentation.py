"""What the documentation says of keys, options, defaults and numbers is what the code says."""

import dataclasses
import importlib
import json
import re
import runpy
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from pydoc import locate
from typing import Any

import click
import numpy as np
import pytest
import yaml
from verification.reference_page import page
from verification.validation.command_faults import FAULTS

import strandline as sl
from strandline.cli.main import COMMANDS
from strandline.design.active import CRITERIA, Active
from strandline.discrepancy import DISCREPANCIES
from strandline.models import MODELS
from strandline.models.biofilm.outline import Outline
from strandline.posterior import SobolIndices
from strandline.priors import PRIORS
from strandline.readers import READERS, Reading, read_interface
from strandline.runs import RunRequest, attempt
from strandline.studies import check_posterior
from strandline.studies.build import build_model
from strandline.studies.keys import StudyFile
from strandline.studies.keys.listed import listed
from strandline.studies.keys.observation import ObservationFile
from strandline.surrogate import KERNELS
from strandline.testing.studies import BEAM_STUDY, write_study

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def text_of(page: str) -> str:
    return (DOCS / page).read_text("utf-8")


def rows(page: str, heading: str) -> list[list[str]]:
    """Return the cells of the table whose first column is called `heading`."""
    found, inside = [], False
    for line in text_of(page).splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("|") and cells[0] == heading:
            inside = True
        elif not line.startswith("|"):
            inside = False
        elif inside and not cells[0].startswith("---"):
            found.append(cells)
    return found


def code(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text_of(page), re.DOTALL)


def written(default: Any) -> str:
    return default if isinstance(default, str) else json.dumps(default)


def test_every_key_of_a_study_is_listed_with_a_meaning() -> None:
    assert text_of("reference/study.md") == page(), "run python -m verification.reference_page"
    found = listed(StudyFile)
    assert len(found) > 80
    silent = {key.name for key in found if not key.meaning}
    assert silent == {f"observation.{name}" for name in set(ObservationFile.model_fields) & READING - {"columns"}}


READING = {field.name for field in dataclasses.fields(Reading)} - {"file", "unit"}
"""How to read a file: one line of the page says so of all."""
GIVEN = ("sensitivities", "folder")
"""Fields of models that are no options of theirs: a key of the study, and the study folder."""


def test_every_option_of_models_and_measures_is_described_with_its_default() -> None:
    classes = {name: locate(target.replace(":", ".")) for name, target in MODELS.items()} | DISCREPANCIES
    fields = {name: [f for f in dataclasses.fields(c) if f.init and f.name not in GIVEN] for name, c in classes.items()}
    known = {(name, f.name): default_of(f) for name, some in fields.items() for f in some}
    tables = [*rows("reference/study.md", "model"), *rows("reference/study.md", "measure")]
    described = {(code(r[0])[0], code(r[1])[0]): (code(r[2]) or [r[2]])[0] for r in tables if r[1]}
    assert described == known
    assert {code(row[0])[0] for row in tables} == set(classes)


def test_every_prior_kernel_criterion_format_and_option_of_reading_is_described() -> None:
    described = {code(row[0])[0]: row[1] for row in rows("reference/study.md", "prior")}
    assert described == {name: prior.fields for name, prior in PRIORS.items()}
    assert all(f"`{name}`" in text_of("reference/study.md") for name in KERNELS)
    (criterion,) = (row[2] for row in rows("reference/study.md", "key") if code(row[0]) == ["design.active.criterion"])
    assert set(code(criterion)) == {*CRITERIA, "module:name"}
    assert code(criterion)[0] == Active(80).criterion
    reading = {name for row in rows("reference/study.md", "reading") for name in code(row[0])}
    assert reading == {f.name for f in dataclasses.fields(Reading)}
    assert {suffix for row in rows("reference/study.md", "files") for suffix in code(row[0])} == set(READERS)
    assert set(ObservationFile.model_fields) - {"synthetic", "noise", "image", "stack"} == reading


def default_of(field: Any) -> str:
    if field.default_factory is not dataclasses.MISSING:
        return written(field.default_factory())
    if field.default is dataclasses.MISSING:
        return "required"
    nested = dataclasses.is_dataclass(field.default) or field.default == ()
    return "the study's" if nested else written(field.default)


def test_every_command_is_described_with_its_options() -> None:
    described = {
        code(row[0])[0]: {option.split()[0] for option in code(row[1])}
        for row in rows("reference/command-line.md", "command")
    }
    known = {}
    for name, command in every_command():
        arguments = [p for p in command.params if isinstance(p, click.Argument)]
        options = {p.opts[0] for p in command.params if isinstance(p, click.Option)}
        metavars = [argument.make_metavar(click.Context(command)) for argument in arguments]
        known[" ".join(["strandline", name, *metavars])] = options
    assert described == known


def every_command() -> Iterator[tuple[str, click.Command]]:
    """Yield the commands with their names, those of groups as ``GROUP COMMAND``."""
    for name in COMMANDS:
        command = importlib.import_module(f"strandline.cli.{name.replace('-', '_')}").command
        if isinstance(command, click.Group):
            yield from ((f"{name} {inner}", item) for inner, item in command.commands.items())
        else:
            yield name, command


def test_every_public_name_has_its_module_on_a_page_of_the_api() -> None:
    pages = re.findall(r"^api/(\S+)$", text_of("reference/python.md"), re.MULTILINE)
    shown = {re.findall(r"automodule:: (\S+)", text_of(f"reference/api/{page}.md"))[0] for page in pages}
    assert shown == {f"strandline.{page}" for page in pages}
    for module in shown:
        importlib.import_module(module)
    homes = {name: getattr(sl, name).__module__ for name in sl.__all__}
    ancestors = {name: {home, home.rpartition(".")[0]} for name, home in homes.items()}
    assert [name for name, modules in ancestors.items() if not modules & shown] == []


def test_the_numbers_on_quadratures_are_those_of_the_outline() -> None:
    reference, table = Outline().interface(), rows("explanation/quadratures.md", "nodes of the second polyline")
    assert len(table) == 3
    for nodes, *figures in table:
        other = reference.resampled(int(nodes))
        for quadrature, figure in zip(("centre", "refined"), figures, strict=True):
            value = sl.Currents(0.005, quadrature=quadrature)(other, reference)
            assert f"{value:.2g}" == f"{float(figure):.2g}"


def test_the_beams_of_the_guides_run_and_are_that_of_the_example() -> None:
    block = next(block for block in blocks("how-to/own-simulator.md", "python") if "def beam" in block)
    shown: dict[str, Any] = {"np": np, "sl": sl}
    exec(block, shown)
    inputs = {"E": 400.0, "q": 0.25}
    single = runpy.run_path(str(ROOT / "examples" / "own_model.py"))["beam"](inputs, Path())
    np.testing.assert_allclose(shown["beam"](inputs, Path()).points, single.points, rtol=1e-14)
    beam, problem = blocks("how-to/several-experiments.md", "python")
    exec(beam, shown)
    record = attempt(shown["beam"], RunRequest("key", {"E": 400.0}), Path())
    assert list(record.interfaces) == ["light", "heavy"]
    np.testing.assert_allclose(record.interfaces["heavy"].points, single.points, rtol=1e-14)
    shown |= record.interfaces | {"space": sl.ParameterSpace((sl.Parameter("E", sl.Uniform(1.0, 2.0)),))}
    exec(problem, shown)
    likelihood = sl.InterfaceLikelihood(shown["observed"], sl.MeasurementLines(10))
    assert likelihood(record.interfaces) == pytest.approx(0.0)


SAMPLER = "{smc: {particles: 400, rejuvenation_steps: 2, zeta: 0.5}}"
SMALL = yaml.safe_load(SAMPLER)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study of the guide on simulators, finished as a draft, in a folder as the guides name it."""
    home: Path = tmp_path_factory.mktemp("home")
    folder = home / "studies" / "biofilm-uniform"
    folder.mkdir(parents=True)
    study = next(block for block in blocks("how-to/own-simulator.md", "yaml") if "{python:" in block)
    (folder / "study.yaml").write_text(f"{study}draft: true\nreport: none\nsampler: {SAMPLER}\n", encoding="utf-8")
    shutil.copy(ROOT / "examples" / "own_model.py", folder)
    sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    return home


@pytest.fixture(scope="module")
def uncertain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The summary of a study with a nuisance input."""
    inputs = {**BEAM_STUDY["inputs"], "tilt": {**BEAM_STUDY["inputs"]["tilt"], "nuisance": True}}
    sampler = {**SMALL, "cut": {"values": 2}}
    folder = write_study(
        tmp_path_factory.mktemp("uncertain"), draft=True, report="none", inputs=inputs, sampler=sampler
    )
    return sl.run_study(sl.load_study(folder), executor=sl.InProcess()).summary


def test_every_key_of_the_summary_is_described(finished: Path, uncertain: dict[str, Any]) -> None:
    summary = json.loads((finished / "studies/biofilm-uniform/summary.json").read_text("utf-8"))
    described = {key for row in rows("reference/summary.md", "key") for key in code(row[0])}
    described -= {"quadrature_check", "under_uncertainty.cut.quadrature_check"}
    described = {key for key in described if not key.startswith("sampler_check.")}  # see test_sampler_check
    stated = ("point_sd", "correlation_length", "shift_sd", "rotation_sd", "scale_sd", "offset_sd", "inferred_noise")
    described = {key for key in described if not key.startswith(tuple(f"likelihood.{name}" for name in stated))}
    described = {key.replace("READING", reading) for key in described for reading in ("joint", "cut")}
    known = set(generic(summary)) | {key for key in generic(uncertain) if key.startswith("under_uncertainty.")}
    known = {key for key in known if not key.startswith("under_uncertainty.cut.quadrature_check.")}
    known = {key for key in known if not key.startswith(("measures.", "surrogate.optimiser."))}
    assert summary["sensitivity"] is None  # the study has one input
    kinds = {f"inputs.NAME.{f.name}" for f in dataclasses.fields(SobolIndices)} - {"inputs.NAME.evaluations"}
    known = known - {"sensitivity"} | {f"sensitivity.{key}" for key in kinds | {"of", "evaluations"}}
    assert described == known | {"measures.MEASURE", "surrogate.optimiser"}
    assert summary["measures"].keys() == {"measurement_lines"}
    assert generic(summary["measures"]["measurement_lines"]) == generic(summary["surrogate"])


@pytest.fixture(scope="module")
def active(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The summary of a study with an active design, checked by runs."""
    design = {"active": {"runs": 60, "batch": 4, "check": 20, "change": 0.5}}
    changes = {"design": design, "sampler": SMALL, "noise": {"sd": 0.01}, "report": "none"}
    folder = write_study(tmp_path_factory.mktemp("active"), **changes)
    return sl.run_study(sl.load_study(folder), executor=sl.InProcess()).summary


def test_every_key_of_an_active_design_of_a_field_is_described(active: dict[str, Any]) -> None:
    for heading, part in (("field", "surrogate"), ("certificate", "certificate"), ("comparison", "comparison")):
        described = {key for row in rows("reference/summary.md", heading) for key in code(row[0])}
        assert described - {"certificate.check"} == {f"{part}.{key}" for key in generic(active[part])}
    entries = {code(row[0])[0]: set(code(row[1])) for row in rows("reference/summary.md", "certificate")}
    for name in ("batches", "history"):
        first, *_ = active["certificate"][name]
        assert set(first) <= entries[f"certificate.{name}"]


def test_every_key_of_the_check_is_described(finished: Path) -> None:
    folder = finished / "studies/biofilm-uniform"
    check_posterior(sl.load_study(folder), draws=20, executor=sl.InProcess())
    content = json.loads((folder / "check.json").read_text("utf-8"))
    content["runs"]["by_kind"] = {"some_kind": 1}
    described = {key for row in rows("reference/check.md", "key") for key in code(row[0])}
    assert described == set(generic(content)) | {f"interfaces[].{key}" for key in generic(content["interfaces"][0])}


PLACEHOLDERS = {"versions": "PACKAGE", "runs.by_kind": "KIND", "measures": "MEASURE", "seconds": "STAGE"}
PLACEHOLDERS |= dict.fromkeys(
    (
        "fixed", "inputs", "warps", "variance_effect.shift", "variance_effect.sd_ratio", "check.shift",
        "check.shift_error", "check.sd_ratio", "under_uncertainty.joint.inputs", "under_uncertainty.cut.inputs",
        "under_uncertainty.cut.nuisance_values",
    ),
    "NAME",
)  # fmt: skip


def generic(tree: Mapping[str, Any], place: str = "") -> list[str]:
    """Return the dotted keys of a summary with placeholders for the names that a study brings."""
    found: dict[str, None] = {}
    for name, value in tree.items():
        is_input = place == "quadrature_check" and isinstance(value, dict)
        shown = "NAME" if is_input else PLACEHOLDERS.get(place, name)
        key = f"{place}.{shown}" if place else shown
        branches = isinstance(value, dict) and value and key != "truth"
        found |= dict.fromkeys(generic(value, key) if branches else [key])
    return list(found)


def printed_by(program: str, folder: Path) -> str:
    command = [sys.executable, "-W", "ignore", "-c", program]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_programs_that_read_results_run(finished: Path) -> None:
    pieces = blocks("how-to/read-results.md", "python")
    assert len(pieces) == 5
    done = printed_by("\n".join(pieces), finished)
    summary = json.loads((finished / "studies/biofilm-uniform/summary.json").read_text("utf-8"))
    first, second = done.splitlines()[:2]
    assert float(first.split()[0]) == summary["inputs"]["E"]["mean"]
    assert float(second.split()[0]) == pytest.approx(summary["inputs"]["E"]["mean"], rel=1e-12)
    assert done.count(" ok ") == summary["runs"]["ok"] + 1  # and the observation


@pytest.mark.long
def test_the_program_that_checks_a_posterior_runs(finished: Path) -> None:
    (program,) = blocks("how-to/check-the-posterior.md", "python")
    done = printed_by(program, finished)
    content = json.loads((finished / "studies/biofilm-uniform/check.json").read_text("utf-8"))
    assert done.split()[0] == content["verdict"]


PIECES = (
    "change-without-runs", "model-error", "noise", "own-observation", "several-experiments", "uncertain-experiment",
    "what-if",
)  # fmt: skip


def test_the_pieces_of_studies_in_the_guides_are_valid() -> None:
    whole = yaml.safe_load((ROOT / "studies" / "biofilm-uniform" / "study.yaml").read_text("utf-8"))
    for guide in PIECES:
        pieces = blocks(f"how-to/{guide}.md", "yaml")
        assert pieces, guide
        for piece in pieces:
            StudyFile.model_validate(whole | yaml.safe_load(piece.replace("…\n", "")))


def test_models_of_the_guide_to_an_own_flow_cell_are_built(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "hill.csv", [[900, 0], [1270, 600], [2100, 0]], delimiter=",")
    pages = blocks("how-to/own-flow-cell.md", "yaml")
    assert len(pages) == 13
    for one in pages:
        (options,) = yaml.safe_load(one)["model"].values()
        assert build_model({"biofilm": options}, tmp_path)


def test_studies_and_ends_of_runs_are_those_of_the_examples_and_of_the_faults() -> None:
    (shown,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    assert shown == (ROOT / "studies" / "biofilm-uniform" / "study.yaml").read_text("utf-8")
    shown = next(block for block in blocks("how-to/own-simulator.md", "yaml") if "command:" in block)
    assert shown == (ROOT / "examples" / "command" / "study.yaml").read_text("utf-8")
    described = {(code(row[0])[0], kind) for row in rows("how-to/own-simulator.md", "state") for kind in code(row[1])}
    assert {(fault.state, fault.kind) for fault in FAULTS if fault.kind} <= described


def test_the_table_of_the_guide_on_abaqus_is_read(tmp_path: Path) -> None:
    result = next(block for block in blocks("how-to/own-simulator.md", "yaml") if block.startswith("result:"))
    (script,) = blocks("how-to/own-simulator.md", "text")
    compile(script, "extract.py", "exec")
    (tmp_path / "interface.csv").write_text("x,y,ux,uy\n1.0,0.0,0.0,0.5\n0.0,0.0,0.0,0.0\n")
    reading = Reading.from_options(yaml.safe_load(result)["result"], "result")
    assert read_interface(tmp_path / reading.file, reading).points.tolist() == [[0.0, 0.0], [1.0, 0.5]]
