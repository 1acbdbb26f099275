"""Files with a common fault are read right, or refused in one line; they are never read wrongly."""

import meshio
import numpy as np
import pytest
from tests.unit.readers.reads import read

from strandline.foundations import InvalidInput

SEEDS = pytest.mark.parametrize("seed", range(20))
UNITS = {"mm": 1.0, "um": 1e-3, "m": 1e3}
ENDS = ["", "[{0}]", "_{0}", "({0})", "/{0}", ".{0}", "pos", "-coordinate", "1"]  # {0}: the file's unit
Y_FIRST = ["y{0},x{0}", '"y{0}","x{0}"', "Row{0},Col{0}", "axis-0,axis-1", "pos_y,pos_x", "r,c", "Points:1,Points:0"]
Y_FIRST += [
    "PositionY,PositionX",
    "cy,cx",
    "YM,XM",
    "dim_0,dim_1",
    "centroid-0,centroid-1",
    "p[1],p[0]",
    "Zeile,Spalte",
]
OPEN = ["i,j", "j,i", "top,left", "elevation,distance", "u,v", "z,r", "theta,r", "# i,j", "# top,left", "left,top"]
COMMENTS = ["# y{0},x{0}", "% y{0} x{0}", "#y,x\n# in mm", "# columns: y, x", "# row{0};col{0}", "# 1: y\n# 2: x"]
COMMENTS += ["# columns: row, col", "# Column: axis-0, axis-1", "# first column row, second column col"]
LABELS = [
    "id",
    "n",
    "load step",
    "increment",
    "polyline",
    "t",
    "time_[s]",
    "frame_id",
    "ContourID",
    "polygon",
    "segment_no",
    "POSITION_T",
    "ObjectNumber",
]
LOST = [
    ["***", "***"],
    ["*" * 12],
    ["***", "1.5"],
    ["NA", "NA"],
    ["#N/A", "#N/A"],
    ["nan", "1"],
    ["########", "########"],
    ["########", "1.5"],
    ["nan%", "nan%"],
    ["(0.5)", "(0.5)"],
]
DISPLACEMENTS = ["u", "U", "uh", "displacement", "Total_Displacement", "DEPL", "deformation", "disp (mm)"]
COMPONENTS = ["ux", "u_y", "U1", "disp_x", "displacement magnitude"]
CELLS = {"quad": ["0231"], "triangle": ["023", "031"], "tetra": ["0467", "0627", "0237", "0317", "0157", "0547"]}


def is_right(path, points, *, closed=False, unit="mm", size=None, **options):
    """Return whether the file is read, with a `size` in any order; fail if it is wrong, or read without `points`."""
    try:
        found = read(path, unit=unit, **options)
    except InvalidInput as error:
        return pytest.fail(str(error)) if "\n" in str(error) else False
    text = str(path.read_bytes()[:200])
    assert (points is not None, found.closed) == (True, closed), text
    expected = np.array(points, float) * UNITS[unit]
    if size is None:
        np.testing.assert_allclose(found.points, expected, rtol=1e-12, err_msg=text)
        return True
    np.testing.assert_allclose(np.sort(found.points, axis=0), np.sort(expected, axis=0), atol=0.01)
    assert (found.areas if expected.shape[1] == 3 else found.lengths).sum() == pytest.approx(size, rel=0.01)
    return True


@pytest.fixture
def case(seed, tmp_path):
    """Random numbers; the rows of a random line, or of an outline; a function that writes lines and checks the file."""
    rng = np.random.default_rng(seed)
    separator, decimals, unit = rng.choice([",", "\t", ";", " "]), rng.integers(2, 7), str(rng.choice(list(UNITS)))

    def draw(*, closed=False):
        number = int(rng.integers(6, 30))
        x, y = rng.uniform(0.2, 9, number).cumsum(), rng.uniform(-9, 9, number)
        if closed:
            angle, radius = 2 * np.pi * np.arange(number) / number, rng.uniform(20, 25, number)
            x, y = radius * np.cos(angle), radius * np.sin(angle)
        return [[f"{value:.{decimals}f}" for value in point] for point in zip(x, y, strict=True)]

    def check(lines, points, **options):
        path = tmp_path / "a.txt"
        path.write_text("\n".join(row if isinstance(row, str) else separator.join(row) for row in lines) + "\n")
        return is_right(path, points, unit=unit, **options)

    check.unit = unit
    return rng, draw, check


@SEEDS
def test_another_unit_displacements_and_decimal_commas(case):
    rng, draw, check = case
    points, other = draw(), rng.choice(["mm", "um", "µm", "m", "cm", "px", "nm"])
    for names in ("x_{0},y_{0}", "X[{0}],Y[{0}]", '"x({0})","y({0})"'):
        header = names.format(other).split(",")
        assert check([header, *points], points) is (other.replace("µ", "u") == check.unit)
        assert check([names.format(check.unit).split(","), *points], points)
    for names in ("ux,uy", "u_x,u_y", "dx,dy", "disp_x,disp_y"):
        assert not check([names.split(","), *points], None)
        assert check([names.split(","), *points], points, columns=[1, 2])
    short = [",".join(f"{abs(float(value)):.2f}".replace(".", ",") for value in point) for point in points]
    assert not check([*short, "1,05,2,05"], None, columns=[1, 3])


@SEEDS
@pytest.mark.parametrize("header", [[], [["n", "x", "y"]]])
def test_a_row_with_another_number_of_fields(case, header):
    rng, draw, check = case
    points, options = draw(), {"columns": ["x", "y"]} if header else {}
    rows = np.column_stack([range(len(points)), points]).tolist() if header else points
    assert check([*header, *rows], points, **options)
    at, field = rng.integers(len(rows)), rng.integers(len(rows[0]))
    before, after = rows[at][:field], rows[at][field + 1 :]
    for change in ([], ["1.5", rows[at][field]], [""]):
        check([*header, *rows[:at], [*before, *change, *after], *rows[at + 1 :]], points, **options)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    fixed = ["".join(value.rjust(width) for value, width in zip(row, widths, strict=True)) for row in rows]
    check([*map(" ".join, header), *fixed], points, **options)


@SEEDS
def test_y_before_x(case, tmp_path):
    rng, draw, check = case
    points, end = draw(), rng.choice(ENDS).format(check.unit)
    swapped = [row[::-1] for row in points]
    for names in rng.choice(Y_FIRST, 3, replace=False):
        y, x = names.format(end).split(",")
        check([[y, x], *swapped], points)
        assert check([[x, y], *points], points) is not names.startswith(("Row", "Zeile"))
    assert check([f"# x,y\n# in {check.unit}", *points], points)
    for names in OPEN:
        assert not check([names.split(","), *points], None)
        assert check([names.split(","), *swapped], points, columns=[2, 1])
    for names in (["# my drop"], ["# pixel 3.2nm"], ["# format x-y"], ["'x'", "'y'"], ["<x>", "<y>"]):
        assert check([names, *points], points)
    for names in rng.choice(COMMENTS, 3, replace=False):
        check([names.format(end), *swapped], points)
    for array, columns in ((swapped, None), (swapped, [2, 1]), (np.transpose(points), [1, 2])):
        np.save(tmp_path / "a.npy", np.array(array, float))
        assert is_right(tmp_path / "a.npy", points, columns=columns) is (columns == [2, 1])


@SEEDS
def test_several_pieces_in_one_file(case):
    rng, draw, check = case
    one, two = draw(), draw()
    count, picked = str(len(one)), {"columns": [2, 3]}
    for between in ("", " \t", "# next", "x y"):
        check([*one, between, *two], None)
    for first in ([count, "2"], [count, "0"], ["2", count]):
        check([first, *one], one)
    check([[count, "2"], *one, [str(len(two)), "2"], *two], None)
    header, label = [rng.choice(LABELS), "x", "y"], rng.choice(["1", "0.1", "left"])
    assert check([header, *np.column_stack([range(len(one)), one])], one, **picked)
    for labels in ([label] * len(one) + ["2"] * len(two), [*range(len(one)), *range(len(two))]):
        check([header, *np.column_stack([labels, one + two])], None, **picked)
    check(np.column_stack([[1] * len(one) + [2] * len(two), one + two]).tolist(), None, **picked)


@SEEDS
def test_first_rows_with_digits_or_stars_and_a_closing_point(case):
    _, draw, check = case
    points = draw(closed=True)
    digit = 10.0 ** -len(points[0][0].partition(".")[2])
    for header in ([], ["# 12 points"], ["*Node 1"], [["x1", "y1"]]):
        for least in (0.0, 1e-9, digit):
            last = [f"{float(value) + least:.12f}" for value in points[0]]
            assert check([*header, *points, last], points, closed=True) or least == digit
    for names in (["0", "1"], ["1", "2"], ["* 1", "2"]):
        check([names, *points, points[0]], points, closed=True)
    for lost in LOST:
        check([lost, *points[1:]], None)
        check([*points[1:], lost], None)


@SEEDS
def test_meshes_with_nodes_of_their_own_or_with_displacements(seed, tmp_path):
    rng, path, kind = np.random.default_rng(seed), tmp_path / "a.vtu", list(CELLS)[seed % 3]
    number, (x, y, z), solid = int(rng.integers(1, 6)), rng.uniform(0.5, 5, 3), kind == "tetra"
    points = np.array([[i * x, j * y, k * z] for i in range(number + 1) for j in (0, 1) for k in range(1 + solid)])
    cells = np.array([[int(k) + i * (2 + 2 * solid) for k in cell] for i in range(number) for cell in CELLS[kind]])
    size = 2 * (number * x * (y + z) + y * z) if solid else 2 * (number * x + y)

    def check(places, moved, data=(), **options):
        nodes = cells if len(places) == len(points) else np.arange(cells.size).reshape(cells.shape)
        meshio.vtu.write(path, meshio.Mesh(places, [(kind, nodes)], point_data=dict(data)), binary=False)
        return is_right(path, moved[:, : 2 + solid], closed=True, size=size, **options)

    assert check(points, points)
    for noise in (0.0, *10.0 ** rng.uniform([-16, -9, -5], [-9, -5, -3])):
        shift = noise * rng.uniform(-1, 1, (cells.size, 3)) * [1, 1, solid]
        assert check(points[cells.ravel()] + shift, points) or noise > 1e-5
    vector, name = np.zeros_like(points), rng.choice(DISPLACEMENTS)
    assert check(points, points, [(name, vector), ("velocity", vector + 7)])
    vector[:, 0] = 3.0
    for data in ([("U", 0 * vector), (name, vector)], [(rng.choice(COMPONENTS), vector[:, 0])]):
        check(points, points + vector, data)
        assert check(points, points, data, field="none")
    assert check(points, points + vector, [(name, vector)], field=str(name))
