"""Numbers in VTK's XML files, written here by the format's description; what XDMF may refer to; what may unpack."""

import base64
import lzma
import zlib

import h5py
import numpy as np
import pytest

from strandline.readers import Reading, Unreadable, read_interface

POINTS = np.array([[0.0, 0, 0], [1, 0.5, 0], [2, 0.25, 0]])
LINES = np.array([[0, 1], [1, 2]])
ARRAYS = {"points": POINTS, "connectivity": np.array([0, 1, 2]), "offsets": np.array([3])}


def packed(array, order, header, *, compressed, text, apart):
    """Return one array as VTK writes it."""
    data = array.astype(np.dtype(order + array.dtype.str[1:])).tobytes()
    count = np.dtype(order + header)
    encode = base64.b64encode if text else bytes
    if not compressed:
        head = np.array([len(data)], count).tobytes()
        return encode(head) + encode(data) if apart else encode(head + data)
    blocks = [data[:16], data[16:]] if len(data) > 16 else [data]
    small = [zlib.compress(block) for block in blocks]
    head = np.array([len(blocks), 16, len(blocks[-1]) % 16, *map(len, small)], count).tobytes()
    return encode(head) + encode(b"".join(small))


def vtp(form, *, order="<", header="u4", compressed=False, apart=False):
    """Return a VTP file of one polyline."""
    appended, elements = b"", {}
    for name, array in ARRAYS.items():
        data = packed(array, order, header, compressed=compressed, text=form != "raw", apart=apart)
        place = 'format="binary"' if form == "binary" else f'format="appended" offset="{len(appended)}"'
        elements[name] = (
            f'<DataArray type="{array.dtype.name.title()}" Name="{name}" '
            f'NumberOfComponents="{2 * array.ndim - 1}" {place}>'
            f"{data.decode() if form == 'binary' else ''}</DataArray>"
        )
        appended += data
    root = f'<VTKFile type="PolyData" byte_order="{"LittleEndian" if order == "<" else "BigEndian"}"'
    root += f' header_type="UInt{8 * int(header[1])}"'
    root += ' compressor="vtkZLibDataCompressor">' if compressed else ">"
    body = f'<PolyData><Piece NumberOfPoints="3" NumberOfLines="1"><Points>{elements["points"]}</Points>'
    body += f"<Lines>{elements['connectivity']}{elements['offsets']}</Lines></Piece></PolyData>"
    tail = f'<AppendedData encoding="{form}">\n _'.encode() + appended + b"\n</AppendedData>"
    return (root + body).encode() + (b"" if form == "binary" else tail) + b"</VTKFile>"


def read(path):
    return read_interface(path, Reading(path.name, "mm", start=(0.0, 0.0))).points


def refused(words, path):
    with pytest.raises(Unreadable, match=words):
        read(path)


def test_every_encoding_is_read_and_what_is_cut_off_is_refused(tmp_path):
    for form in ("binary", "raw", "base64"):
        for order, header in (("<", "u4"), (">", "u8"), ("<", "u8")):
            for compressed, apart in ((False, False), (False, True), (True, False)):
                file = vtp(form, order=order, header=header, compressed=compressed, apart=apart)
                (tmp_path / "a.vtp").write_bytes(file)
                np.testing.assert_array_equal(read(tmp_path / "a.vtp"), POINTS[:, :2])
                (tmp_path / "a.vtp").write_bytes(file[: -len(b"</VTKFile>") - 20])
                refused("a.vtp", tmp_path / "a.vtp")


def test_a_small_file_does_not_unpack_to_a_large_one(tmp_path):
    path, number = tmp_path / "bomb.vtp", 80
    for name, pack in (("ZLib", zlib.compress), ("LZMA", lzma.compress)):
        block = pack(bytes(10**6))
        head = np.array([number, 10**6, 0, *[len(block)] * number], "<u4").tobytes()
        text = (base64.b64encode(head) + base64.b64encode(number * block)).decode()
        path.write_text(
            f'<VTKFile type="PolyData" compressor="vtk{name}DataCompressor"><PolyData><Piece NumberOfPoints="3">'
            f'<Points><DataArray type="Float64" NumberOfComponents="3" format="binary">{text}</DataArray></Points>'
            "</Piece></PolyData></VTKFile>"
        )
        refused(r"bomb\.vtp .*unpack to more than \d\d MB, from 0\.\d+ MB", path)


@pytest.fixture
def inner(tmp_path):
    """A folder with a file of numbers, beside another such file."""
    (tmp_path / "inner" / "sub").mkdir(parents=True)
    for path in ("outside.h5", "inner/a.h5", "inner/sub/b.h5"):
        with h5py.File(tmp_path / path, "w") as file:
            file["points"], file["lines"] = POINTS, LINES
    return tmp_path / "inner"


def xdmf(folder, points, lines="a.h5:/lines", form="HDF"):
    """Write an XDMF file whose numbers are where two texts say."""
    path = folder / "m.xdmf"
    path.write_text(
        '<Xdmf Version="3.0"><Domain><Grid><Geometry GeometryType="XYZ">'
        f'<DataItem DataType="Float" Precision="8" Dimensions="3 3" Format="{form}">{points}</DataItem></Geometry>'
        '<Topology TopologyType="Polyline" NumberOfElements="2" NodesPerElement="2">'
        f'<DataItem DataType="Int" Precision="8" Dimensions="2 2" Format="HDF">{lines}</DataItem></Topology>'
        "</Grid></Domain></Xdmf>"
    )
    return path


def test_only_data_beside_xdmf_and_below_are_read(inner):
    np.testing.assert_array_equal(read(xdmf(inner, "a.h5:/points", "sub/b.h5:/lines")), POINTS[:, :2])
    outside = inner.parent / "outside.h5"
    (inner / "link.h5").symlink_to(outside)
    for source in (outside, "../outside.h5", "link.h5"):
        refused("outside of its folder", xdmf(inner, f"{source}:/points"))
    POINTS.tofile(inner / "points.bin")
    refused("of the format Binary", xdmf(inner, str(inner / "points.bin"), form="Binary"))


def test_hdf5_does_not_lead_out_either(inner):
    outside, raw = str(inner.parent / "outside.h5"), str(inner.parent / "raw.bin")
    POINTS.tofile(raw)
    with h5py.File(inner / "a.h5", "a") as file:
        file["linked"] = h5py.ExternalLink(outside, "/points")
        file["soft"] = h5py.SoftLink("/linked")
        file.create_dataset("stored", POINTS.shape, "f8", external=[(raw, 0, POINTS.nbytes)])
        layout = h5py.VirtualLayout(POINTS.shape, "f8")
        layout[:] = h5py.VirtualSource(outside, "points", POINTS.shape)
        file.create_virtual_dataset("virtual", layout)
    for name, words in (("linked", "elsewhere"), ("soft", "elsewhere"), ("stored", "other"), ("virtual", "other")):
        refused(f"a.h5 refers to data .*{words}", xdmf(inner, f"a.h5:/{name}"))


def test_data_that_unpack_to_far_more_than_their_file_are_not_read(inner):
    with h5py.File(inner / "a.h5", "a") as file:  # 96 MB of zeros
        file.create_dataset("many", (4 * 10**6, 3), "f8", chunks=(10**6, 3), compression="gzip")
    refused(r"unpack to more than \d\d MB", xdmf(inner, "a.h5:/many"))
