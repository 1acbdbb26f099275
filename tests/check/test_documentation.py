"""What the documentation says of keys, options, defaults and numbers is what the code says; the citation is of it."""

import dataclasses
import importlib
import json
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.doors.models.command_faults import FAULTS
from verification.reference_page import pages

import strandline as sl
from strandline.design.active import CRITERIA
from strandline.discrepancy import DISCREPANCIES
from strandline.models import MODELS
from strandline.parameters import PRIORS
from strandline.readers import READERS, Reading
from strandline.runs import RunRequest, attempt
from strandline.studies import StudyFile, check_posterior
from strandline.studies.keys.observation import ObservationFile
from strandline.studies.load.models import build_model
from strandline.surrogate import KERNELS
from strandline.testing.studies import BEAM_STUDY, write_study

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def text_of(page):
    return (DOCS / page).read_text("utf-8")


def rows(page, heading):
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


def code(cell):
    return re.findall(r"`([^`]+)`", cell)


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", text_of(page), re.DOTALL)


def described(page, heading):
    """Return what the first column of a table describes; `a.{b,c}` is a.b and a.c."""
    return {one for row in rows(page, heading) for name in code(row[0]) for one in spelt_out(name)}


def spelt_out(name):
    before, _, rest = name.partition("{")
    inner, _, after = rest.partition("}")
    return [before + one + end for one in inner.split(",") for end in (spelt_out(after) if after else [""])]


def test_tables_that_the_code_knows_are_up_to_date_and_leave_no_meaning_out():
    """Keys of a study, options of models, measures and commands, examples."""
    for page, text in pages().items():
        assert text_of(f"reference/{page}") == text, "run python -m verification.reference_page"
    for page, heading, least in (("study", "key", 80), ("study", "model", 50), ("command-line", "command", 100)):
        found = rows(f"reference/{page}.md", heading)
        assert len(found) > least
        assert [row[0] for row in found if not row[-1]] == []


def test_every_model_and_measure_is_named_with_what_the_table_leaves_out():
    study = text_of("reference/study.md")
    named = {
        name.partition(".")[0] for heading in ("model", "measure") for name in described("reference/study.md", heading)
    }
    assert named | {"tracked_points", "normal_offset"} == {*MODELS, *DISCREPANCIES}
    assert all(f"`{name}" in study for name in ("tracked_points", "normal_offset", "result", "results", "success"))


def test_every_prior_kernel_criterion_format_and_option_of_reading_is_described():
    priors = {code(row[0])[0]: row[1] for row in rows("reference/study.md", "prior")}
    assert priors == {name: prior.fields for name, prior in PRIORS.items()}
    assert all(f"`{name}`" in text_of("reference/study.md") for name in KERNELS)
    (criterion,) = (row[2] for row in rows("reference/study.md", "key") if code(row[0]) == ["design.active.criterion"])
    assert set(code(criterion)) == {*CRITERIA, "module:name"}
    reading = {f.name for f in dataclasses.fields(Reading)}
    said = code(text_of("reference/study.md").partition("\n## Files\n")[2].partition("\n## ")[0])
    assert {name.partition(":")[0] for name in said} >= reading - {"file", "unit"}
    assert described("reference/study.md", "files") == set(READERS)
    assert set(ObservationFile.model_fields) - {"synthetic", "noise", "image", "stack"} == reading


def test_every_public_name_has_its_module_on_a_page_of_the_api():
    pages = re.findall(r"^api/(\S+)$", text_of("reference/python.md"), re.MULTILINE)
    modules = {page: importlib.import_module(f"strandline.{page}") for page in pages}
    promised = {name for module in modules.values() for name in getattr(module, "__all__", ())}
    homes = {name: getattr(sl, name).__module__.removeprefix("strandline.") for name in sl.__all__}
    elsewhere = {name for name, home in homes.items() if not {home, home.rpartition(".")[0]} & {*pages}}
    assert elsewhere - promised == set()


def test_the_beams_of_the_guides_run_and_are_that_of_the_example():
    block = next(block for block in blocks("how-to/own-simulator.md", "python") if "def beam" in block)
    shown = {"np": np, "sl": sl}
    exec(block, shown)
    inputs = {"E": 400.0, "q": 0.25}
    single = runpy.run_path(str(ROOT / "examples" / "own_model.py"))["beam"](inputs, Path())
    np.testing.assert_allclose(shown["beam"](inputs, Path()).points, single.points, rtol=1e-14)
    beam, problem = blocks("how-to/experiment.md", "python")
    exec(beam, shown)
    record = attempt(shown["beam"], RunRequest("key", {"E": 400.0}), Path())
    np.testing.assert_allclose(record.interfaces["heavy"].points, single.points, rtol=1e-14)
    exec(problem, shown | record.interfaces | {"space": sl.ParameterSpace((sl.Parameter("E", sl.Uniform(1.0, 2.0)),))})


STUDY = "studies/biofilm-uniform"
SAMPLER = "{smc: {particles: 400, rejuvenation_steps: 2, zeta: 0.5}}"
SMALL = yaml.safe_load(SAMPLER)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The study of the guide on simulators, finished as a draft, in a folder as the guides name it."""
    home = tmp_path_factory.mktemp("home")
    folder = home / STUDY
    folder.mkdir(parents=True)
    study = next(block for block in blocks("how-to/own-simulator.md", "yaml") if "{python:" in block)
    (folder / "study.yaml").write_text(f"{study}draft: true\nreport: none\nsampler: {SAMPLER}\n", encoding="utf-8")
    shutil.copy(ROOT / "examples" / "own_model.py", folder)
    sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    return home


def summary_of(folder, **changes):
    """Run a small study of a beam; return its summary."""
    folder = write_study(folder, **{"report": "none", "sampler": SMALL} | changes)
    return sl.run_study(sl.load_study(folder), executor=sl.InProcess()).summary


def test_every_key_of_the_summary_is_described(finished, tmp_path):
    """That of one study, and what another one with a nuisance input has besides."""
    inputs = {**BEAM_STUDY["inputs"], "tilt": {**BEAM_STUDY["inputs"]["tilt"], "nuisance": True}}
    uncertain = summary_of(tmp_path / "study", draft=True, inputs=inputs, sampler=SMALL | {"cut": {"values": 2}})
    summary = json.loads((finished / STUDY / "summary.json").read_text("utf-8"))
    keys = described("reference/files.md", "summary.json") | described("reference/files.md", "everywhere")
    keys = {key.replace("READING", reading) for key in keys for reading in ("joint", "cut")}
    known = set(generic(summary)) | {key for key in generic(uncertain) if key.startswith("under_uncertainty.")}
    within = ("under_uncertainty.cut.quadrature_check.", "measures.", "surrogate.optimiser.")
    assert {key for key in known if not key.startswith(within)} - keys == {"sensitivity"}  # null, of one input


def test_every_key_of_an_active_design_of_a_field_is_described(tmp_path):
    design = {"active": {"runs": 60, "batch": 4, "check": 20, "change": 0.5}}
    active = summary_of(tmp_path / "study", design=design, noise={"sd": 0.01})
    for heading, part in (("field", "surrogate"), ("certificate", "certificate"), ("comparison", "comparison")):
        keys = described("reference/files.md", heading) - {"certificate.check"}
        assert keys == {f"{part}.{key}" for key in generic(active[part])}
    entries = {code(row[0])[0]: set(code(row[1])) for row in rows("reference/files.md", "certificate")}
    for name in ("batches", "history"):
        first, *_ = active["certificate"][name]
        assert set(first) <= entries[f"certificate.{name}"]


def test_every_key_of_the_check_is_described(finished):
    folder = finished / STUDY
    check_posterior(sl.load_study(folder), draws=20, executor=sl.InProcess())
    content = json.loads((folder / "check.json").read_text("utf-8"))
    content["runs"]["by_kind"] = {"some_kind": 1}
    known = set(generic(content)) | {f"interfaces[].{key}" for key in generic(content["interfaces"][0])}
    everywhere = described("reference/files.md", "everywhere")
    assert described("reference/files.md", "check.json") | (everywhere & known) == known


PLACEHOLDERS = {"versions": "PACKAGE", "runs.by_kind": "KIND", "measures": "MEASURE", "seconds": "STAGE"}
NAMED = ["fixed", "inputs", "warps", "variance_effect.shift", "variance_effect.sd_ratio", "check.shift"]
NAMED += ["check.shift_error", "check.sd_ratio", "under_uncertainty.joint.inputs", "under_uncertainty.cut.inputs"]
PLACEHOLDERS |= dict.fromkeys([*NAMED, "under_uncertainty.cut.nuisance_values"], "NAME")


def generic(tree, place=""):
    """Return the dotted keys of a summary with placeholders for the names that a study brings."""
    found = {}
    for name, value in tree.items():
        is_input = place == "quadrature_check" and isinstance(value, dict)
        shown = "NAME" if is_input else PLACEHOLDERS.get(place, name)
        key = f"{place}.{shown}" if place else shown
        branches = isinstance(value, dict) and value and key != "truth"
        found |= dict.fromkeys(generic(value, key) if branches else [key])
    return list(found)


def printed_by(program, folder):
    command = [sys.executable, "-W", "ignore", "-c", program]
    return subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, text=True, timeout=120, check=True).stdout


def test_the_programs_that_read_results_run(finished):
    pieces = blocks("how-to/results.md", "python")
    assert len(pieces) == 5
    done = printed_by("\n".join(pieces), finished)
    summary = json.loads((finished / STUDY / "summary.json").read_text("utf-8"))
    first, second = done.splitlines()[:2]
    assert float(first.split()[0]) == summary["inputs"]["E"]["mean"]
    assert float(second.split()[0]) == pytest.approx(summary["inputs"]["E"]["mean"], rel=1e-12)
    assert done.count(" ok ") == summary["runs"]["ok"] + 1  # and the observation


@pytest.mark.long
def test_the_program_that_checks_a_posterior_runs(finished):
    (program,) = blocks("how-to/trust.md", "python")
    done = printed_by(program, finished)
    content = json.loads((finished / STUDY / "check.json").read_text("utf-8"))
    assert done.split()[0] == content["verdict"]


PIECES = "experiment next noise picture specimens what-if"


def test_the_pieces_of_studies_in_the_guides_are_valid():
    whole = yaml.safe_load((ROOT / STUDY / "study.yaml").read_text("utf-8"))
    for guide in PIECES.split():
        pieces = blocks(f"how-to/{guide}.md", "yaml")
        assert pieces, guide
        for piece in pieces:
            StudyFile.model_validate(whole | yaml.safe_load(piece.replace("…\n", "")))


def test_models_of_the_guide_to_an_own_flow_cell_are_built(tmp_path):
    np.savetxt(tmp_path / "hill.csv", [[900, 0], [1270, 600], [2100, 0]], delimiter=",")
    pages = blocks("how-to/own-flow-cell.md", "yaml")
    assert len(pages) == 10
    for one in pages:
        (options,) = yaml.safe_load(one)["model"].values()
        assert build_model({"biofilm": options}, tmp_path)


def test_studies_and_ends_of_runs_are_those_of_the_examples_and_of_the_faults():
    (shown,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    assert shown == (ROOT / STUDY / "study.yaml").read_text("utf-8")
    shown = next(block for block in blocks("how-to/own-simulator.md", "yaml") if "command:" in block)
    assert shown == (ROOT / "examples" / "command" / "study.yaml").read_text("utf-8")
    ends = {(code(row[0])[0], kind) for row in rows("how-to/own-simulator.md", "state") for kind in code(row[1])}
    assert {(fault.state, fault.kind) for fault in FAULTS if fault.kind} <= ends


def test_citation_and_change_log_are_of_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["version"] == sl.__version__
    assert f"\n## {sl.__version__}\n" in (ROOT / "CHANGELOG.md").read_text("utf-8")
    assert citation["references"][0]["doi"] in (ROOT / "README.md").read_text("utf-8")
