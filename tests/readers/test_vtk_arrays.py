"""Binary numbers in VTK's XML files, written here by the format's description."""

import base64
import lzma
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from strandline.readers import Reading, Unreadable, read_interface

POINTS = np.array([[0.0, 0, 0], [1, 0.5, 0], [2, 0.25, 0]])
ARRAYS = {"points": POINTS, "connectivity": np.array([0, 1, 2]), "offsets": np.array([3])}
DTYPES = {"points": "Float64", "connectivity": "Int64", "offsets": "Int64"}


def packed(array: np.ndarray, order: str, header: str, *, compressed: bool, text: bool, apart: bool) -> bytes:
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


def written(path: Path, form: str, *, order: str = "<", header: str = "u4", compressed: bool = False, apart: bool = False) -> Path:  # fmt: skip  # noqa: E501
    """Write a VTP file of one polyline."""
    appended, offsets, inline = b"", {}, {}
    for name, array in ARRAYS.items():
        data = packed(array, order, header, compressed=compressed, text=form != "raw", apart=apart)
        offsets[name], inline[name] = len(appended), data.decode() if form == "binary" else ""
        appended += data
    place = {n: 'format="binary"' if form == "binary" else f'format="appended" offset="{offsets[n]}"' for n in ARRAYS}
    element = {
        n: f'<DataArray type="{DTYPES[n]}" Name="{n}" NumberOfComponents="{3 if n == "points" else 1}" {place[n]}>'
        f"{inline[n]}</DataArray>"
        for n in ARRAYS
    }
    root = f'<VTKFile type="PolyData" byte_order="{"LittleEndian" if order == "<" else "BigEndian"}"'
    root += f' header_type="{ {"u4": "UInt32", "u8": "UInt64"}[header] }"'
    root += ' compressor="vtkZLibDataCompressor">' if compressed else ">"
    body = f'<PolyData><Piece NumberOfPoints="3" NumberOfLines="1"><Points>{element["points"]}</Points>'
    body += f"<Lines>{element['connectivity']}{element['offsets']}</Lines></Piece></PolyData>"
    tail = b""
    if form != "binary":
        tail = f'<AppendedData encoding="{"raw" if form == "raw" else "base64"}">\n _'.encode() + appended
        tail += b"\n</AppendedData>"
    path.write_bytes(('<?xml version="1.0"?>\n' + root + body).encode() + tail + b"</VTKFile>")
    return path


def read(path: Path) -> np.ndarray:
    return read_interface(path, Reading(path.name, "mm")).points


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("header", ["u4", "u8"])
@pytest.mark.parametrize("form", ["binary", "raw", "base64"])
@pytest.mark.parametrize(("compressed", "apart"), [(False, False), (False, True), (True, False)])
def test_every_encoding(tmp_path: Path, order: str, header: str, form: str, compressed: bool, apart: bool) -> None:
    path = written(tmp_path / "a.vtp", form, order=order, header=header, compressed=compressed, apart=apart)
    np.testing.assert_array_equal(read(path), POINTS[:, :2])


@pytest.mark.parametrize("form", ["binary", "raw", "base64"])
@pytest.mark.parametrize("compressed", [False, True])
def test_every_truncation_is_refused(tmp_path: Path, form: str, compressed: bool) -> None:
    path = written(tmp_path / "a.vtp", form, compressed=compressed)
    whole = path.read_bytes()
    for cut in range(0, len(whole) - len(b"</VTKFile>"), 7):
        path.write_bytes(whole[:cut])
        with pytest.raises(Unreadable):
            read(path)


@pytest.mark.parametrize("compressed", [False, True])
def test_damage_in_the_middle_is_an_error_or_other_numbers_but_no_crash(tmp_path: Path, compressed: bool) -> None:
    path = written(tmp_path / "a.vtp", "raw", compressed=compressed)
    whole, random, refusals = path.read_bytes(), np.random.default_rng(1), 0
    for _ in range(200):
        damaged = bytearray(whole)
        for place in random.integers(0, len(whole), 3):
            damaged[place] = random.integers(256)
        path.write_bytes(bytes(damaged))
        try:
            read(path)
        except Unreadable:
            refusals += 1
    assert refusals > 100


BOMB = 80 * 10**6


@pytest.mark.parametrize(("name", "pack"), [("ZLib", zlib.compress), ("LZMA", lzma.compress)])
def test_a_small_file_does_not_unpack_to_a_large_one(tmp_path: Path, name: str, pack: Callable[[bytes], bytes]) -> None:
    block = pack(bytes(BOMB // 4))
    head = np.array([4, BOMB // 4, 0, *[len(block)] * 4], "<u4").tobytes()
    text = (base64.b64encode(head) + base64.b64encode(4 * block)).decode()
    path = tmp_path / "bomb.vtp"
    path.write_text(
        f'<VTKFile type="PolyData" compressor="vtk{name}DataCompressor"><PolyData><Piece NumberOfPoints="3"><Points>'
        f'<DataArray type="Float64" NumberOfComponents="3" format="binary">{text}</DataArray></Points></Piece>'
        "</PolyData></VTKFile>"
    )
    assert path.stat().st_size < 10**6
    with pytest.raises(Unreadable, match=r"bomb\.vtp cannot be read: .*unpack to more than \d\d MB, from 0\.\d+ MB"):
        read(path)


def test_a_list_of_files_names_each_once_and_no_other_list(tmp_path: Path) -> None:
    written(tmp_path / "a.vtp", "raw")
    for sources, words in (
        (["a.vtp", "a.vtp"], "names a.vtp more than once"),
        (["p.pvtp"], "data of the type PPolyData"),
    ):
        pieces = "".join(f'<Piece Source="{source}"/>' for source in sources)
        (tmp_path / "p.pvtp").write_text(f'<VTKFile type="PPolyData"><PPolyData>{pieces}</PPolyData></VTKFile>')
        with pytest.raises(Unreadable, match=words):
            read(tmp_path / "p.pvtp")
