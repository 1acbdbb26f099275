"""How observed-half.csv and observed-full.csv were made: a run on a finer mesh, seen at 20 places along it, with noise.

The truth is mu = 22 kPa, stiffening = 0.25, p = 2.04 kPa. Run it in this folder: python make_observation.py
"""

import subprocess
import tempfile
from pathlib import Path

import numpy as np
from jinja2 import Environment, StrictUndefined

from strandline.readers import Reading, read_interface

TRUTH = {"mu": 22.0, "stiffening": 0.25, "p": 2.04}
NOISE, PLACES, SEED = 0.1, 20, 1


def main() -> None:
    here = Path(__file__).parent
    template = (here / "bulge.inp.j2").read_text(encoding="utf-8").replace("10.0, 1.0, 40, 2", "10.0, 1.0, 80, 4")
    environment = Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    rng = np.random.default_rng(SEED)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "bulge.inp").write_text(environment.from_string(template).render(**TRUTH), encoding="ascii")
        subprocess.run(["ccx", "-i", "bulge"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        for time, load in enumerate(("half", "full"), 1):
            printed = Reading("bulge.dat", "mm", time={"value": time})
            outline = read_interface(folder / "bulge.dat", printed).points
            length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(outline, axis=0), axis=1)))
            seen = np.linspace(0.0, length[-1], PLACES)
            points = np.stack([np.interp(seen, length, column) for column in outline.T], axis=1)
            points += NOISE * rng.normal(size=points.shape)
            np.savetxt(here / f"observed-{load}.csv", points, delimiter=",", header="r,z", comments="", fmt="%.4f")


if __name__ == "__main__":
    main()
