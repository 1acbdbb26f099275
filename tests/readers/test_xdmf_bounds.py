"""What XDMF may refer to, and how much its data may unpack to."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.readers import Reading, Unreadable, read_interface

h5py = pytest.importorskip("h5py")
pytest.importorskip("meshio")

POINTS = np.array([[0.0, 0, 0], [1, 0.5, 0], [2, 0.25, 0]])
LINES = np.array([[0, 1], [1, 2]])


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """An HDF5 file beside the folder of the XDMF file."""
    return hdf5(tmp_path / "outside.h5")


@pytest.fixture
def inner(tmp_path: Path) -> Path:
    folder = tmp_path / "inner"
    folder.mkdir()
    return folder


def hdf5(path: Path, **datasets: Any) -> Path:
    with h5py.File(path, "w") as file:
        for name, data in ({"points": POINTS, "lines": LINES} | datasets).items():
            file[name] = data
    return path


def xdmf(path: Path, points: str, lines: str, form: str = "HDF") -> Path:
    """Write an XDMF file whose numbers are where two texts say."""
    path.write_text(
        '<Xdmf Version="3.0"><Domain><Grid><Geometry GeometryType="XYZ">'
        f'<DataItem DataType="Float" Precision="8" Dimensions="3 3" Format="{form}">{points}</DataItem></Geometry>'
        '<Topology TopologyType="Polyline" NumberOfElements="2" NodesPerElement="2">'
        f'<DataItem DataType="Int" Precision="8" Dimensions="2 2" Format="HDF">{lines}</DataItem></Topology>'
        "</Grid></Domain></Xdmf>"
    )
    return path


def read(path: Path) -> np.ndarray:
    return read_interface(path, Reading(path.name, "mm", start=(0.0, 0.0))).points


def test_data_beside_it_and_below_are_read(inner: Path) -> None:
    (inner / "sub").mkdir()
    hdf5(inner / "a.h5")
    hdf5(inner / "sub" / "b.h5")
    found = read(xdmf(inner / "m.xdmf", "a.h5:/points", "sub/b.h5:/lines"))
    np.testing.assert_array_equal(found, POINTS[:, :2])


@pytest.mark.parametrize("how", ["absolute", "above", "link"])
def test_data_outside_of_its_folder_are_not_opened(inner: Path, outside: Path, how: str) -> None:
    hdf5(inner / "a.h5")
    (inner / "link.h5").symlink_to(outside)
    source = {"absolute": str(outside), "above": "../outside.h5", "link": "link.h5"}[how]
    with pytest.raises(Unreadable, match="outside of its folder"):
        read(xdmf(inner / "m.xdmf", f"{source}:/points", "a.h5:/lines"))


def test_binary_files_are_not_opened(inner: Path) -> None:
    hdf5(inner / "a.h5")
    POINTS.tofile(inner / "points.bin")
    with pytest.raises(Unreadable, match="of the format Binary, which is not read"):
        read(xdmf(inner / "m.xdmf", str(inner / "points.bin"), "a.h5:/lines", "Binary"))


def test_hdf5_does_not_lead_out_either(inner: Path, outside: Path) -> None:
    with h5py.File(inner / "a.h5", "w") as file:
        file["lines"] = LINES
        file["linked"] = h5py.ExternalLink(str(outside), "/points")
        file["soft"] = h5py.SoftLink("/linked")
        raw = inner.parent / "raw.bin"
        POINTS.tofile(raw)
        file.create_dataset("stored", POINTS.shape, "f8", external=[(str(raw), 0, POINTS.nbytes)])
        layout = h5py.VirtualLayout(POINTS.shape, "f8")
        layout[:] = h5py.VirtualSource(str(outside), "points", POINTS.shape)
        file.create_virtual_dataset("virtual", layout)
    for name, words in (
        ("linked", "elsewhere"),
        ("soft", "elsewhere"),
        ("stored", "other files"),
        ("virtual", "other"),
    ):
        with pytest.raises(Unreadable, match=f"a.h5 refers to data .*{words}"):
            read(xdmf(inner / "m.xdmf", f"a.h5:/{name}", "a.h5:/lines"))


def test_data_that_unpack_to_far_more_than_their_file_are_not_read(inner: Path) -> None:
    with h5py.File(inner / "a.h5", "w") as file:
        file["lines"] = LINES
        file.create_dataset("points", (4 * 10**6, 3), "f8", chunks=(10**6, 3), compression="gzip")  # 96 MB of zeros
    with pytest.raises(Unreadable, match=r"unpack to more than \d\d MB"):
        read(xdmf(inner / "m.xdmf", "a.h5:/points", "a.h5:/lines"))
