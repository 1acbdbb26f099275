"""Simulators that are programs: one that writes surfaces as VTK, calibrated from a stack, and an example."""

import shutil
from pathlib import Path

from tests.study.conftest import SAMPLER
from tests.unit.discrepancy.surfaces import sphere
from tests.unit.studies.test_stacks import RADIUS, V, loaded

from strandline.runs import InProcess, LocalProcesses
from strandline.studies import load_study, run_study
from strandline.studies.pictures.stack_files import vtu

PROGRAM = """
radius, inside, out = float(open("input.txt").read()), False, []
for line in open("ball.vtu").read().splitlines():
    inside = line == "<Points>" or (inside and line != "</Points>")
    numbers = inside and "<" not in line
    out.append(" ".join(str(radius * float(x)) for x in line.split()) if numbers else line)
open("surface.vtu", "w").write("\\n".join(out))
"""
"""Write the surface of a ball with the radius that the input file states."""


def test_it_finds_the_radius(tmp_path):
    """The posterior holds the true radius; its width is that of the offset, not of independent points."""
    (tmp_path / "ball.vtu").write_text(vtu(sphere(1.0, 3)), "utf-8")
    (tmp_path / "ball.py").write_text(PROGRAM, "utf-8")
    (tmp_path / "input.txt.j2").write_text("{{ radius }}", "utf-8")
    command = {
        "command": ["{{ python }}", "ball.py"],
        "templates": {"input.txt.j2": "input.txt"},
        "files": ["ball.py", "ball.vtu"],
        "result": {"file": "surface.vtu", "unit": "mm"},
    }
    study = {
        "model": {"command": command},
        "fixed": {},
        "inputs": {"radius": {"prior": {"uniform": [0.0135, 0.0145]}}},
        "discrepancy": {"closest_point": {}},
        "design": {"sobol": {"runs": 8}},
        "sampler": SAMPLER,
        "draft": True,
    }
    posterior = run_study(loaded(tmp_path, study=study, triangles=400), executor=InProcess()).calibration.posterior
    assert abs(posterior.mean[0] - RADIUS) < 0.25 * V
    assert 0.08 * V < posterior.sd[0] < 0.25 * V
    assert (tmp_path / "figures" / "surfaces.png").exists()


def test_the_command_example_finds_the_truth(tmp_path):
    study = Path(shutil.copytree(Path(__file__).parents[3] / "examples" / "command", tmp_path / "command"))
    with (study / "study.yaml").open("a", encoding="utf-8") as file:
        file.write("\ndraft: true\nreport: none\n")
    found = run_study(load_study(study), executor=LocalProcesses(workers=1)).summary["inputs"]["E"]
    assert abs(found["mean"] - 400.0) < 3 * found["sd"] < 100.0
