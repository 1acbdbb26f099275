"""Make the studies that the figures of the gallery are drawn from, before these pages are built."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
STUDIES = HERE / "gallery" / "studies"
EXAMPLES = HERE.parent / "examples"
SPECIMENS, SEED, NOISE = 12, 5, 0.003  # outlines; mm, standard deviation


def run_studies(app):
    """Run the studies that were not run yet, or whose study.yaml has changed since."""
    shutil.copytree(
        EXAMPLES / "pendant-drop", STUDIES / "drop", dirs_exist_ok=True, ignore=shutil.ignore_patterns("image")
    )
    write_specimens(STUDIES / "biofilm" / "specimens")
    for folder in sorted(STUDIES.iterdir()):
        if is_finished(folder):
            continue
        command = [sys.executable, "-m", "strandline", "run", str(folder), "--quiet"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def is_finished(folder):
    """Return whether the results are those of study.yaml as it is now."""
    summary = folder / "summary.json"
    if not summary.is_file():
        return False
    from strandline.studies import load_study

    return json.loads(summary.read_text("utf-8"))["study_sha256"] == load_study(folder).text_digest


def write_specimens(folder):
    """Write outlines of biofilms of one population, E = 400 ± 40 Pa, as a camera would see them."""
    if folder.is_dir():
        return
    import strandline as sl

    random = np.random.default_rng(SEED)
    biofilm = sl.Biofilm(mesh="coarse")
    folder.mkdir()
    for number, E in enumerate(400 + 40 * random.standard_normal(SPECIMENS), start=1):
        points = biofilm({"E": E, "nu": 0.3, "V_in": 100.0}).interface.points
        seen = points + NOISE * random.standard_normal(points.shape)
        np.savetxt(folder / f"biofilm-{number:02}.csv", seen, delimiter=",", header="x,y", comments="")
