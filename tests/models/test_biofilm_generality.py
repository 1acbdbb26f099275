"""The biofilm model on other geometries and parts, against closed forms and what must not matter."""

import numpy as np

from strandline.models.biofilm.cell import FlowCell
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.geometry import MeshSize
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.subdivision import Partition

THREE = Partition.PRESETS["three_parts"]
INPUTS = {"E": 400.0, "nu": 0.3, "V_in": 100.0}
PARTS = {"E1": 400.0, "nu1": 0.3, "E2": 400.0, "nu2": 0.3, "E3": 400.0, "nu3": 0.3, "V_in": 100.0}


def _moved(model: Biofilm, inputs: dict[str, float]) -> np.ndarray:
    return model(inputs).interface.points - model.undeformed().points


def test_a_softer_part_matters_and_each_part_is_its_own():
    model = Biofilm(mesh="coarse", partition=THREE)
    base = _moved(model, PARTS)
    changes = [np.abs(_moved(model, {**PARTS, f"E{k}": 800.0}) - base).max() for k in (1, 2, 3)]
    assert min(changes) > 1e-3
    assert len({round(change, 5) for change in changes}) == 3


def test_open_outlet_changes_the_flow_only_near_the_outlet():
    far = Channel(length=4.0)
    horizontal = _moved(Biofilm(mesh="coarse", channel=far), INPUTS)
    opened = _moved(Biofilm(mesh="coarse", channel=Channel(length=4.0, outlet="traction_free")), INPUTS)
    change = np.abs(opened - horizontal).max()
    assert 0 < change < 1e-2 * np.abs(horizontal).max()


def test_layer_is_sheared_downstream_by_the_wall_shear_stress():
    """Far from its ends a flat layer is in simple shear: u(top) = τ H/G with τ = 6 μ V/h², h the free height."""
    H, E, nu, V = 0.1, 1e5, 0.3, 100.0
    size = MeshSize(far=0.1, interface=0.05, foot=0.05, grading=0.5)
    layer = Outline(((0.0, H), (2.0, H), (4.0, H)), spline=False, nodes=81)
    law = LAWS["saint_venant_kirchhoff"]
    cell = FlowCell(layer.interface(), size, channel=Channel(length=4.0), partition=Partition(), law=law)
    moved = cell.solve([E], [nu], V).displacement
    shear = 6e-3 * V / (1 - H) ** 2  # μ = 1e-3 Pa s, V in mm²/s, lengths in mm: Pa
    expected = shear * H / (E / (2 * (1 + nu)))
    np.testing.assert_allclose(moved[40, 0], expected, rtol=0.02)
