"""Files for ParaView are opened again by meshio."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from tests.unit.models.biofilm.cells import coarse

from strandline.errors import InvalidInput
from strandline.models.biofilm.paraview import write_vtu

meshio = pytest.importorskip("meshio")


def test_vtu_holds_the_fields_and_numbers_the_parts_by_their_markers(tmp_path):
    model = coarse(partition="three_parts")
    solids = {name: value for k in (1, 2, 3) for name, value in ((f"E{k}", 400.0), (f"nu{k}", 0.3))}
    fields = model.fields({**solids, "V_in": 100.0})
    collection = write_vtu(fields, tmp_path / "out")
    files = [item.get("file") for item in ElementTree.parse(collection).iter("DataSet")]
    assert files == ["undeformed.vtu", "deformed.vtu"]
    undeformed, deformed = (meshio.read(collection.parent / name) for name in files)
    moved = deformed.points - undeformed.points
    np.testing.assert_allclose(deformed.points[:, :2], fields.points)
    np.testing.assert_allclose(moved, deformed.point_data["displacement [mm]"], atol=1e-15)
    np.testing.assert_allclose(deformed.point_data["pressure [Pa]"], fields.pressure)
    np.testing.assert_array_equal(deformed.cells_dict["triangle"], fields.triangles)
    assert 250 < np.linalg.norm(deformed.point_data["velocity [mm/s]"], axis=1).max() < 300
    part, stress = (deformed.cell_data[name][0] for name in ("part", "Cauchy stress [Pa]"))
    np.testing.assert_allclose(stress[:, [0, 1, 3, 2]], fields.stress)
    assert not stress[:, 4:].any()
    assert not stress[part == 0].any()
    assert np.abs(stress).max() > 1.0
    assert set(part.tolist()) == {0, 1, 2, 3}
    centres = undeformed.points[undeformed.cells_dict["triangle"]].mean(axis=1)[:, :2]
    for number, marker in enumerate(model.partition.markers, 1):
        assert part[np.argmin(np.linalg.norm(centres - marker, axis=1))] == number
    (tmp_path / "file").touch()
    with pytest.raises(InvalidInput, match="can be written"):
        write_vtu(fields, tmp_path / "file" / "out")
