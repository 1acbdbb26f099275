"""The accuracy of the biofilm model's meshes, and its bits in another process."""

import subprocess
import sys

import numpy as np
import pytest
from tests.unit.models.biofilm.cells import INPUTS, largest, moved

from strandline.models.biofilm.model import Biofilm


def test_coarse_mesh_is_as_accurate_as_it_is_said_to_be():
    coarse, default = Biofilm(mesh="coarse"), Biofilm()
    np.testing.assert_allclose(largest(moved(default, INPUTS)), 0.0495, rtol=0.01)
    for inputs in (INPUTS, {"E": 130.0, "nu": -0.54, "V_in": 100.0}):
        error = largest(coarse(inputs).interface.points - default(inputs).interface.points)
        assert error < 3e-4  # mm; the default mesh's own error is below 1e-4
    near = [largest(moved(default, {"E": 254.0, "nu": 0.31, "V_in": rate})) for rate in (99.0, 100.0)]
    assert near[0] < near[1]  # Newton's method at once may end on the second branch there


@pytest.mark.long
def test_default_mesh_is_converged_against_the_fine_one():
    coarse, default, fine = (Biofilm(mesh=name)(INPUTS).interface.points for name in ("coarse", "default", "fine"))
    error = largest(default - fine)
    assert error < 5e-5  # 0.05 µm, 0.1 % of the largest displacement
    assert largest(coarse - fine) > 3 * error


def test_same_inputs_same_bits_in_another_process():
    run = f"Biofilm(mesh='coarse')({INPUTS!r}).interface.points.tobytes().hex()"
    code = f"from strandline.models.biofilm.model import Biofilm; print({run})"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    ours = Biofilm(mesh="coarse")(INPUTS).interface.points.tobytes().hex()
    assert other.stdout.strip().splitlines()[-1] == ours
