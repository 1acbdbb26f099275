"""Files for ParaView are opened again by meshio."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.paraview import write_vtu

meshio = pytest.importorskip("meshio")


def test_vtu_holds_the_fields(tmp_path):
    fields = Biofilm(mesh="coarse").fields({"E": 400.0, "nu": 0.3, "V_in": 100.0})
    collection = write_vtu(fields, tmp_path / "out")
    files = [item.get("file") for item in ElementTree.parse(collection).iter("DataSet")]
    assert files == ["undeformed.vtu", "deformed.vtu"]
    undeformed, deformed = (meshio.read(collection.parent / name) for name in files)
    np.testing.assert_allclose(deformed.points[:, :2], fields.points)
    np.testing.assert_allclose(
        deformed.points - undeformed.points, deformed.point_data["displacement [mm]"], atol=1e-15
    )
    np.testing.assert_allclose(deformed.point_data["pressure [Pa]"], fields.pressure)
    np.testing.assert_array_equal(deformed.cells_dict["triangle"], fields.triangles)
    assert set(deformed.cell_data["part"][0].tolist()) == {0, 1}
    speed = np.linalg.norm(deformed.point_data["velocity [mm/s]"], axis=1)
    assert 250 < speed.max() < 300
    stress = deformed.cell_data["Cauchy stress [Pa]"][0]
    np.testing.assert_allclose(stress[:, [0, 1, 3, 2]], fields.stress)
    assert not stress[:, 4:].any()
    assert not stress[deformed.cell_data["part"][0] == 0].any()
    assert np.abs(stress).max() > 1.0


def test_vtu_numbers_the_parts_by_their_markers(tmp_path):
    model = Biofilm.from_options(mesh="coarse", partition="three_parts")
    solids = {name: value for k in (1, 2, 3) for name, value in ((f"E{k}", 400.0), (f"nu{k}", 0.3))}
    write_vtu(model.fields({**solids, "V_in": 50.0}), tmp_path)
    undeformed = meshio.read(tmp_path / "undeformed.vtu")
    part, centres = undeformed.cell_data["part"][0], undeformed.points[undeformed.cells_dict["triangle"]].mean(axis=1)
    for number, marker in enumerate(model.partition.markers, 1):
        assert part[np.argmin(np.linalg.norm(centres[:, :2] - marker, axis=1))] == number
    assert set(part.tolist()) == {0, 1, 2, 3}


def test_folder_that_cannot_be_made_is_refused(tmp_path):
    fields = Biofilm(mesh="coarse").fields({"E": 400.0, "nu": 0.3, "V_in": 0.0})
    (tmp_path / "file").touch()
    with pytest.raises(InvalidInput, match="can be written"):
        write_vtu(fields, tmp_path / "file" / "out")
