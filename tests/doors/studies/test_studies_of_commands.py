"""A simulator that is a program and writes surfaces as VTK, calibrated from a stack."""

from tests.study.conftest import SAMPLER
from tests.unit.discrepancy.surfaces import sphere
from tests.unit.studies.test_stacks import RADIUS, V, loaded

from strandline.runs import InProcess
from strandline.studies import run_study
from strandline.studies.write.shown import vtu

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
    files = {"templates": {"input.txt.j2": "input.txt"}, "files": ["ball.py", "ball.vtu"]}
    result = {"file": "surface.vtu", "unit": "mm"}
    study = {
        "model": {"command": {"command": ["{{ python }}", "ball.py"], **files, "result": result}},
        "fixed": {},
        "inputs": {"radius": {"prior": {"uniform": [0.0135, 0.0145]}}},
        "design": {"sobol": {"runs": 8}},
        "sampler": SAMPLER,
        "draft": True,
    }
    posterior = run_study(loaded(tmp_path, study=study, triangles=400), executor=InProcess()).calibration.posterior
    assert abs(posterior.mean[0] - RADIUS) < 0.25 * V
    assert 0.08 * V < posterior.sd[0] < 0.25 * V
    assert (tmp_path / "figures" / "surfaces.png").exists()
