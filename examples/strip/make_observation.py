"""Write observed.csv: what a photograph from the side would show of a strip with B = 40 mN mm, tilted by 1 degree."""

from pathlib import Path

import numpy as np
from strip import overhang

TRUTH = {"B": 40.0, "tilt": 1.0, "w": 7.85e-4, "L": 60.0}
NOISE = 0.15  # mm, standard deviation along the normal

if __name__ == "__main__":
    points = overhang(TRUTH, Path()).points[4::4, :2]
    along = np.gradient(points, axis=0)
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    seen = points + NOISE * np.random.default_rng(5).standard_normal((len(points), 1)) * normals
    np.savetxt(Path(__file__).with_name("observed.csv"), seen, fmt="%.3f", delimiter=",", header="x,y", comments="")
