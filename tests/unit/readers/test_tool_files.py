"""Files laid out as their tools write them: read rightly, or refused by the name of the format with the way out."""

import json

import meshio
import numpy as np
import pytest
from tests.unit.readers.reads import read, refused

from strandline.foundations import InvalidInput
from strandline.readers import Reading
from strandline.testing.readers import CHECKS

ARC = [[0.0, 0.0], [0.2, 0.15], [0.4, 0.25], [0.6, 0.25], [0.8, 0.15], [1.0, 0.0]]
SQUARE = [[10.0, 5.0], [20.0, 5.0], [20.0, 15.0], [10.0, 15.0]]
LINE = {"type": "LineString", "coordinates": [[*row, 0.0] for row in ARC]}
RINGS = {"type": "Polygon", "coordinates": [[*SQUARE, SQUARE[0]], [[12, 7], [12, 9], [14, 9], [12, 7]]]}
FEBIO = "".join(
    f"*Step  = {step}\n*Time  = {step / 2}\n*Data  = x;y;z\n"
    + "".join(f"{k} {x} {step * y} 0\n" for k, (x, y) in enumerate(ARC, 1))
    for step in (1, 2)
)
DECK = "*NODE, NSET=ALL\n1, 0.0, 1.0, 0.0\n7, 0.5, 1.0\n** a comment\n9, 1.0, 1.0, 0.0\n*ELEMENT, TYPE=S3\n1, 1, 7, 9\n"
DAT = "".join(
    f"\n displacements (vx,vy,vz) for set TOP and time  0.{step}000000E+01\n\n"
    + "".join(f"{node:10d}  0.000000E+00  {0.1 * step:.6E}  0.000000E+00\n" for node in (9, 7, 1))
    for step in (1, 2)
)
CORNERS = {1: (0.0, 0.0), 2: (10.0, 0.0), 3: (10.0, -0.2), 4: (0.0, -0.2)}
FRD = (
    "    1C\n    2C                             4                                     1\n"
    + "".join(f" -1{node:10d}{x:12.5E}{y:12.5E}{0:12.5E}\n" for node, (x, y) in CORNERS.items())
    + " -3\n    3C                             1                                     1\n"
    + " -1         1    9    0    1\n -2         4         3         2         1\n -3\n"
    + "  100CL  101 1.000000000           4                     0    1           1\n"
    + " -4  DISP        4    1\n -5  D1          1    2    1    0\n -5  D2          1    2    2    0\n"
    + " -5  D3          1    2    3    0\n -5  ALL         1    2    0    0    1ALL\n"
    + "".join(f" -1{node:10d}{-1.5 - node:12.5E}{-2.0:12.5E}{0:12.5E}\n" for node in CORNERS)
    + " -3\n 9999\n"
)
FREEFEM = "4 2 4\n0 0 1\n2 0 1\n2 1 2\n0 1 3\n1 2 3 0\n1 3 4 0\n1 2 1\n2 3 2\n3 4 3\n4 1 4\n"


ENDS = [CORNERS[k] for k in (4, 3, 2, 1)]
MOVED = [[x - 1.5 - k, y - 2] for k, (x, y) in zip((4, 3, 2, 1), ENDS, strict=True)]
RAW = "# U  POINT_DATA 6\n# x  y  z  U_x\n" + "".join(f"{x} {y} 0 7\n" for x, y in ARC[::-1])
PARAVIEW = '"Points:0","Points:1","Points:2"\n' + "".join(f"{x},{y},0\n" for x, y in ARC)


def test_files_of_simulators_and_maps(tmp_path):
    (tmp_path / "job.inp").write_text(DECK)
    for name, content, options, points in (
        ("a.geojson", json.dumps({"type": "FeatureCollection", "features": [{"geometry": LINE}]}), {}, ARC),
        ("a.json", json.dumps(RINGS), {"keep": "longest"}, SQUARE),
        ("nodes.txt", FEBIO, {"time": {"index": 0}}, ARC),
        ("nodes.log", FEBIO, {}, [[x, 2 * y] for x, y in ARC]),
        ("nodes.dat", FEBIO.replace(" 0\n", ",0\n"), {"time": {"value": 0.5}, "plane": "xz"}, [[x, 0] for x, _ in ARC]),
        ("job.dat", DAT, {}, [[1.0, 1.2], [0.5, 1.2], [0.0, 1.2]]),
        ("job.dat", DAT, {"time": {"value": 1}, "sort": "x"}, [[0.0, 1.1], [0.5, 1.1], [1.0, 1.1]]),
        ("job.frd", FRD, {"start": [0, -0.2], "field": "none"}, ENDS),
        ("job.frd", FRD, {"start": [0, -0.2], "field": "DISP"}, MOVED),
        ("th.msh", FREEFEM, {"cells": {"label": [2, 3]}, "start": [2, 0]}, [[2, 0], [2, 1], [0, 1]]),
        ("U_patch.raw", RAW, {"columns": ["x", "y"], "sort": "x"}, ARC),
        ("pv.csv", PARAVIEW, {"columns": ["Points:0", "Points:1"]}, ARC),
    ):  # fmt: skip
        (tmp_path / name).write_text(content)
        np.testing.assert_allclose(read(tmp_path / name, **options).points, points, atol=1e-12, err_msg=name)


def test_each_new_reader_passes_the_conformance_suite(tmp_path):
    (tmp_path / "job.inp").write_text(DECK)
    for name, content in (
        ("a.geojson", json.dumps(LINE)), ("job.dat", DAT), ("job.frd", FRD), ("nodes.txt", FEBIO), ("th.msh", FREEFEM),
    ):  # fmt: skip
        (tmp_path / name).write_text(content)
        part, field = {"label": (1, 2)} if name == "th.msh" else None, "DISP" if name == "job.frd" else None
        how = Reading(name, "mm", cells=part, field=field)
        for check in CHECKS.values():
            check(tmp_path / name, how)


def test_results_written_for_a_set_of_nodes_are_enough_if_these_are_selected(tmp_path):
    """As by `*NODE FILE, NSET=TOP`: nodes 1 and 2, at y = 0, have DISP."""
    rows = [f" -1{node:10d}{-1.5 - node:12.5E}{-2.0:12.5E}{0:12.5E}\n" for node in (3, 4)]
    (tmp_path / "job.frd").write_text(FRD.replace("".join(rows), ""))
    asked = {"field": "DISP", "start": [0, 0]}
    for box in (None, {"y": [-0.2, 0]}):
        told = refused("the point with the number 3", tmp_path / "job.frd", "non_finite", **asked, select=box)
        assert "Write DISP for all nodes, or choose those that have it by `select`." in told
    found = read(tmp_path / "job.frd", **asked, select={"y": [0, 0]})
    np.testing.assert_allclose(found.points, MOVED[:1:-1])
    refused("nothing in the selection", tmp_path / "job.frd", **asked, select={"y": [7, 8]})


def test_meshes_that_gmsh_and_medit_write(tmp_path):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    mesh = meshio.Mesh(points, [("triangle", [[0, 1, 2], [0, 2, 3]]), ("line", [[3, 2], [2, 1]])])
    meshio.medit.write(str(tmp_path / "a.mesh"), mesh)
    meshio.gmsh.write(str(tmp_path / "a.msh"), mesh, fmt_version="2.2")
    for name in ("a.mesh", "a.msh"):
        assert read(tmp_path / name, start=[0, 1]).points.tolist() == [[0, 1], [1, 1], [1, 0]]
    mesh.cell_data, mesh.field_data = (
        {"gmsh:physical": [[7, 7], [1, 2]]},
        {"gel": [7, 2], "top": [1, 1], "side": [2, 1]},
    )
    mesh.cell_data["gmsh:geometrical"] = mesh.cell_data["gmsh:physical"]
    meshio.gmsh.write(str(tmp_path / "a.msh"), mesh, fmt_version="2.2")
    assert read(tmp_path / "a.msh", cells={"top": 1}, start=[0, 1]).points.tolist() == [[0, 1], [1, 1]]
    added = "SubDomainFromGeom\n1\n2 1 1 1\nEnd\n"
    text = (tmp_path / "a.mesh").read_text().replace("MeshVersionFormatted 2", "MeshVersionFormatted 0")
    (tmp_path / "a.mesh").write_text(text.replace("End", added).replace("1.0000000000000000e+00", "1.1"))
    assert read(tmp_path / "a.mesh", start=[0, 1.1]).points.tolist() == [[0, 1.1], [1.1, 1.1], [1.1, 0]]
    (tmp_path / "a.mesh").write_text(text.replace("End", ""))
    refused("cut off", tmp_path / "a.mesh")
    faces = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]
    solid = meshio.Mesh(np.eye(4, 3), [("line", [[0, 1]]), ("triangle", faces), ("tetra", [[0, 1, 2, 3]])])
    meshio.vtk.write(str(tmp_path / "solid.vtk"), solid)
    assert "`block: triangle`" in refused("leaves its plane", tmp_path / "solid.vtk", plane="yz")
    assert len(read(tmp_path / "solid.vtk", block="triangle").cells) == 4


def test_known_formats_are_refused_by_name(tmp_path):
    (tmp_path / "c.inp").write_text(DECK)
    for name, content, words in (
        ("a.svg", b'<?xml version="1.0"?>\n<svg xmlns="x">', "is SVG.*along the curve"),
        ("a.dxf", b"  0\nSECTION\n", "is DXF"),
        ("a.msh", b'(1 "mesh of a bump")\n(2 2)\n', "ANSYS Fluent.*stl"),
        ("a.step", b"ISO-10303-21;", "is STEP.*[Mm]esh"),
        ("a.roi", b"Iout\0\xe4", "selection of ImageJ.*image: {path"),
        ("a.json", b'{\n "version": "6.3.1",\n "flags": {},\n "shapes": []}', "labelme.*image: {path"),
        ("a_cp_outlines.txt", b"10,5,19,5,19,14,10,14\n", "Cellpose.*image: {path"),
        ("a.csv", b"index,shape-type,vertex-index,axis-0,axis-1\n0,path,0,1,2\n", "napari.*image: {path"),
        ("a.xlsx", b"PK\x03\x04", "workbook"),
        ("a.vtkhdf", b"\x89HDF\r\n", "HDF5.*vtu"),
        ("a.nrrd", b"NRRD0005\n", "NRRD.*stack"),
        ("a.nii", b"\0" * 344 + b"n+1\0", "NIfTI.*stack"),
        ("a.inp", b"*NODE\n1, 0, 0\n", "deck of Abaqus"),
        ("d.txt", b"***\n*** Digital Image Correlation Engine (DICe)\n", "DICe.*grid of subsets"),
        ("U.raw", b"# U  FACE_DATA 6\n# x y z U_x U_y U_z\n0 0 0 0 0 0\n", r"OpenFOAM.*columns: \[x, y\].*sort: x"),
        ("p.csv", b'"Points:0","Points:1","Points:2"\n0,0,0\n', 'columns: \\["Points:0", "Points:1"\\]'),
        ("two.vtm", b"<VTKFile/>", "list of blocks by VTK.*Merge"),
        ("j.dat", DAT.encode(), "without places: got no node 9 in j.inp"),
        ("j.frd", FRD.encode(), "may be displacements: got DISP.*`field: DISP`.*`field: none`"),
        ("c.dat", DAT[: DAT.rindex("         1")].encode(), "cut off"),
        ("nodes.txt", FEBIO.replace("x;y;z", "ux;uy;uz").encode(), "no places of nodes"),
    ):  # fmt: skip
        (tmp_path / name).write_bytes(content)
        refused(words, tmp_path / name)
    (tmp_path / "plain.txt").write_text("0,0\n1,1\n2,0\n")
    refused("of one time", tmp_path / "plain.txt", time="last")


OF_COLUMNS = {"columns": [3, 4], "delimiter": ",", "decimal": ",", "sd": 4, "field": [2, 3]}


def test_formats_with_columns_of_their_own_refuse_the_options_of_tables(tmp_path):
    (tmp_path / "job.inp").write_text(DECK)
    (tmp_path / "job.dat").write_text(DAT)
    (tmp_path / "febio.txt").write_text(FEBIO)
    for option, value in OF_COLUMNS.items():
        refused(f"a logfile of FEBio, takes no `{option}`.*`plane: xz`", tmp_path / "febio.txt", **{option: value})
        refused(f"CalculiX prints, takes no `{option}`.*U is added", tmp_path / "job.dat", **{option: value})
        with pytest.raises(InvalidInput, match=f"{option}: .*no such option for a .geojson file"):
            read(tmp_path / "a.geojson", **{option: value})


VTU = """<VTKFile type="UnstructuredGrid" version="0.1"><UnstructuredGrid>
<Piece NumberOfPoints="{points}" NumberOfCells="1">
<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">{places}</DataArray></Points>
<Cells><DataArray type="Int32" Name="connectivity">{nodes}</DataArray><DataArray type="Int32" Name="offsets">{points}
</DataArray><DataArray type="UInt8" Name="types">{kind}</DataArray></Cells></Piece></UnstructuredGrid></VTKFile>"""


def test_voxels_and_strips(tmp_path):
    box = np.array([[x, y, z] for z in (0, 1) for y in (0, 2) for x in (0, 3)])
    strip = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1], [0, 2, 1]])
    for kind, points, area in ((11, box, 22.0), (6, strip, 0.5 + np.sqrt(3))):
        places, nodes = (" ".join(map(str, values)) for values in (points.ravel(), range(len(points))))
        (tmp_path / "a.vtu").write_text(VTU.format(points=len(points), places=places, nodes=nodes, kind=kind))
        found = read(tmp_path / "a.vtu")
        assert found.areas.sum() == pytest.approx(area)
        directions = found.normals * (found.centres - found.points.mean(axis=0))
        assert (directions.sum(axis=1) > 0).all() if kind == 11 else (found.normals[:, 2] > 0).all()


STRIP = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]])


def legacy(version, form, key, nodes):
    """Polygonal data as VTK writes it in a version, with its two ways to list cells, and with data and remarks."""

    def packed(values, kind):
        values = np.ravel(values).astype(kind)
        return " ".join(map(str, values.tolist())).encode() + b"\n" if form == "ASCII" else values.tobytes() + b"\n"

    parts = [f"# vtk DataFile Version {version}\nx\n{form}\nDATASET POLYDATA\nPOINTS 4 float\n".encode()]
    parts += [packed(STRIP, ">f4"), b"METADATA\nINFORMATION 1\nNAME L2 LOCATION x\nDATA 2 0 2\n\n"]
    if version > 5:
        ends = np.cumsum([0, *map(len, nodes)])
        parts += [f"{key} {len(ends)} {ends[-1]}\nOFFSETS vtktypeint64\n".encode(), packed(ends, ">i8")]
        parts += [b"CONNECTIVITY vtktypeint64\n", packed(np.concatenate(nodes), ">i8")]
    else:
        flat = np.concatenate([[len(one), *one] for one in nodes])
        parts += [f"{key} {len(nodes)} {len(flat)}\n".encode(), packed(flat, ">i4")]
    parts += [b"CELL_DATA 1\nSCALARS part int\nLOOKUP_TABLE default\n", packed([7], ">i4")]
    parts += [b"POINT_DATA 4\nNORMALS n float\n", packed(STRIP, ">f4"), b"FIELD FieldData 1\nshift 3 4 double\n"]
    return b"".join([*parts, packed(STRIP[:, [2, 0, 2]], ">f8")])


@pytest.mark.parametrize("form", ["ASCII", "BINARY"])
@pytest.mark.parametrize("version", [3.0, 5.1])
def test_legacy_polygonal_data(tmp_path, version, form):
    path = tmp_path / "a.vtk"
    for key, nodes, area in (("TRIANGLE_STRIPS", [0, 1, 2, 3], (1 + 3**0.5) / 2), ("POLYGONS", [0, 1, 3, 2], 2**0.5)):
        path.write_bytes(legacy(version, form, key, [nodes]))
        assert read(path).areas.sum() == pytest.approx(area)
    path.write_bytes(legacy(version, form, "LINES", [[0, 1, 2]]))
    for check in CHECKS.values():
        check(path, Reading("a.vtk", "mm", cells={"part": 7}))
    assert read(path, cells={"part": 7}, field="shift", start=[0, 0]).points.tolist() == [[0, 0], [1, 1], [0, 1]]


def test_a_table_of_colours_in_a_binary_legacy_file_is_named_with_the_way_out(tmp_path):
    """FreeFEM writes one, which meshio takes for text."""
    begin = b"# vtk DataFile Version 2.0\na\nBINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 2 double\n"
    places, nodes, kind = np.array([0, 0, 0, 1, 0, 0], ">f8"), np.array([2, 0, 1], ">i4"), np.array([3], ">i4")
    parts = [begin, places.tobytes(), b"\nCELLS 1 3\n", nodes.tobytes(), b"\nCELL_TYPES 1\n", kind.tobytes(), b"\n"]
    (tmp_path / "a.vtk").write_bytes(b"".join(parts))
    assert read(tmp_path / "a.vtk", start=[0, 0]).points.tolist() == [[0, 0], [1, 0]]
    (tmp_path / "a.vtk").write_bytes(b"".join([*parts, b"LOOKUP_TABLE FreeFempp_table 1\n", bytes([255, 0, 0, 255])]))
    refused(r"legacy VTK file, BINARY, with a table of colours.*\.vtu, or `bin=false`", tmp_path / "a.vtk")


XDMF = """<Xdmf Version="3.0"><Domain><Grid Name="m" GridType="Uniform">
<Topology TopologyType="Polyline" NumberOfElements="1" NodesPerElement="2">
<DataItem Dimensions="1 2" NumberType="Int" Format="XML">0 1</DataItem></Topology>
<Geometry GeometryType="XY"><DataItem Dimensions="2 2" Format="XML">0 0 1 0</DataItem></Geometry></Grid>
{}</Domain></Xdmf>"""
FUNCTION = '<Grid Name="{0}" GridType="Collection" CollectionType="Temporal">{1}</Grid>'
STEP = """<Grid Name="{0}" GridType="Uniform"><Time Value="{1}"/>
<Attribute Name="{0}" AttributeType="Vector" Center="Node">
<DataItem Dimensions="2 2" Format="XML">0 {1} 0 {1}</DataItem></Attribute></Grid>"""


def test_each_function_of_an_xdmf_file_may_have_its_own_series(tmp_path):
    series = [FUNCTION.format(name, STEP.format(name, 0) + STEP.format(name, 1)) for name in ("u", "p")]
    (tmp_path / "a.xdmf").write_text(XDMF.format("".join(series)))
    for name in ("u", "p"):
        assert read(tmp_path / "a.xdmf", field=name, start=[0, 0]).points.tolist() == [[0, 1], [1, 1]]


def test_displacements_are_added_or_declined(tmp_path):
    mesh = meshio.Mesh(np.array([[0.0, 0, 0], [1, 0, 0]]), [("line", [[0, 1]])])
    for key, values, field, moved in (
        ("displacement", np.ones((2, 3)), "displacement", 1), ("displacement", np.ones((2, 3)), "none", 0),
        ("displacement", np.zeros((2, 3)), None, 0), ("velocity", np.ones((2, 3)), None, 0), ("u", np.ones(2), None, 0),
        ("u", np.ones((2, 3)), None, None), ("Disp", np.ones((2, 3)), None, None),
    ):  # fmt: skip
        mesh.point_data = {key: values}
        meshio.vtu.write(str(tmp_path / "a.vtu"), mesh)
        if moved is None:
            refused(f"may be displacements.*`field: {key}`.*`field: none`", tmp_path / "a.vtu")
        else:
            assert read(tmp_path / "a.vtu", field=field, start=[0, 0]).points[0].tolist() == [moved, moved]
