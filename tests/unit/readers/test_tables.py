"""Points in text files and arrays."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.unit.readers.reads import read, refused

from strandline.foundations import InvalidInput
from strandline.readers import Reading, Unreadable, read_interface, read_point_sds
from strandline.studies.keys.parse import made

POINTS = np.array([[0.0, 0.0], [0.5, 0.25], [1.0, -0.125]])
TABLE = "node, x coord, U1, y coord, U2\n7,0,0,0,0\n8,500,1,250,2\n9,1000,3,-125,4\n"


def written(folder, text, name="points.csv"):
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def rows(points):
    return "\n".join(f"{x},{y}" for x, y in np.asarray(points).tolist())


def test_columns_by_name_and_number_in_another_unit(tmp_path):
    path = written(tmp_path, TABLE)
    for columns in (["x coord", "y coord"], [2, 4]):
        found = read(path, columns=columns, delimiter=",", unit="um")
        np.testing.assert_allclose(found.points, POINTS, rtol=1e-15)
    found = read(path, columns=["x coord", "y coord"], field=["U1", "U2"], delimiter=",", unit="um")
    np.testing.assert_allclose(found.points, POINTS + np.array([[0, 0], [1, 2], [3, 4]]) / 1000, rtol=1e-15)
    for header in ("a b c", "# a b c", "#a b c"):
        text = header + "\n" + "\n".join(f"{y!r} 9 {x!r}" for x, y in POINTS.tolist())
        np.testing.assert_array_equal(read(written(tmp_path, text, "points.dat"), columns=["c", "a"]).points, POINTS)


def test_decimal_commas_are_read_where_they_are_declared(tmp_path):
    named = "# mm\nx, mm;y, mm\n0;0\n5e-1;0,25\n1,0;-0,125\n"
    plain = "0,0;0,0\n0,5;0,25\n1;-0,125"
    blank = [rows(POINTS).replace(",", separator).replace(".", ",") for separator in (" ", "\t", "; ")]
    for text, options in (
        (plain, {}),
        (plain, {"columns": [1, 2]}),
        (named.replace(", mm", ""), {"columns": [1, 2]}),
        (named, {"delimiter": ";"}),
        *((text, {}) for text in blank),
    ):
        np.testing.assert_array_equal(read(written(tmp_path, text), decimal=",", **options).points, POINTS)


def test_only_what_a_program_writes_must_end_its_last_line(tmp_path):
    how = Reading("points.csv", "mm")
    for end, ended in (("\n", True), ("\r\n", True), ("", False)):
        path = written(tmp_path, f"0,0\n1,1.2{end}")
        assert read_interface(path, how, ended=ended).points[-1].tolist() == [1.0, 1.2]
        assert read_interface(path, replace(how, count=2), ended=True).points[-1].tolist() == [1.0, 1.2]
    with pytest.raises(Unreadable, match=r"points\.csv ends within a line: got 1,1\.2; expected a line") as caught:
        read_interface(path, how, ended=True)
    assert caught.value.kind == "result_unreadable"


def test_points_are_sorted_where_asked_and_an_outline_that_repeats_its_first_point_is_closed(tmp_path):
    np.testing.assert_array_equal(read(written(tmp_path, rows(POINTS[[1, 2, 0]])), sort="x").points, POINTS)
    triangle = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    found = read(written(tmp_path, rows([*triangle, triangle[0]])))
    assert found.closed
    assert found.points.tolist() == triangle
    assert not read(written(tmp_path, rows(triangle))).closed


def test_what_cannot_be_seen_is_hidden(tmp_path):
    """A shadow in the middle and a stray end: the polyline goes on behind them."""
    path = written(tmp_path, "".join(f"{0.1 * k},{k % 3}\n" for k in range(30)))
    found = read(path, hide=[{"x": [0.95, 1.45]}, {"x": [2.85, 9.0]}])
    assert found.points[:, 0] == pytest.approx([0.1 * k for k in (*range(10), *range(15, 29))])
    boxes = [{"x": [0.95, 1.45]}, {"x": [100.0, 200.0]}]
    refused("a box of `hide` without a point.*boxes are in mm", path, hide=boxes)


def test_a_box_selects_before_the_displacement_and_does_not_cut(tmp_path):
    path = written(tmp_path, "x,y,u,v\n0,0,9,0\n1,0,9,0\n2,0,9,0\n3,0,9,0\n")
    found = read(path, columns=["x", "y"], field=["u", "v"], select={"x": [0.5, 2.5]})
    np.testing.assert_array_equal(found.points, [[10.0, 0.0], [11.0, 0.0]])
    path = written(tmp_path, "0,0\n1,1.0000001\n2,0.9999999\n3,1\n4,0\n")
    np.testing.assert_array_equal(read(path, select={"y": [1, 1]}).points[:, 0], [1.0, 2.0, 3.0])
    path = written(tmp_path, "0,0\n1,0\n2,5\n3,0\n4,0\n")
    refused(r"into pieces: got the first one ends at \[1.0, 0.0\] mm", path, select={"y": [-1, 1]})


def test_arrays(tmp_path):
    np.save(tmp_path / "a.npy", POINTS.astype(np.float32))
    np.testing.assert_array_equal(read(tmp_path / "a.npy", columns=[1, 2]).points, POINTS)
    refused(r"which column is x.*`columns: \[2, 1\]` for \(row, column\)", tmp_path / "a.npy")
    np.save(tmp_path / "b.npy", np.column_stack([np.arange(3), POINTS]))
    np.testing.assert_array_equal(read(tmp_path / "b.npy", columns=[2, 3]).points, POINTS)
    whole = (tmp_path / "b.npy").read_bytes()
    for cut in (5, 127, 170):
        (tmp_path / "a.npy").write_bytes(whole[:cut])
        refused(r"a\.npy cannot be read", tmp_path / "a.npy")
    for array in (np.zeros(4), np.array([["a", "b"]])):
        np.save(tmp_path / "a.npy", array)
        refused("holds no points", tmp_path / "a.npy")
    np.save(tmp_path / "a.npy", np.zeros((3, 5)))
    refused(r"the 5 columns to take, .* `columns: \[1, 2\]`", tmp_path / "a.npy", columns=[1, 6])


class Trap:
    """An object whose pickle makes a file when it is read."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_a_pickle_is_never_read(tmp_path):
    np.save(tmp_path / "trap.npy", np.array([[Trap(tmp_path / "sprung"), 1.0]], dtype=object), allow_pickle=True)
    refused(r"trap\.npy cannot be read", tmp_path / "trap.npy")
    assert not (tmp_path / "sprung").exists()
    np.load(tmp_path / "trap.npy", allow_pickle=True)
    assert (tmp_path / "sprung").exists()  # the trap works


XY, FIRST = {"columns": ["x", "y"]}, {"columns": [1, 2]}
BAD = [
    ("x,y\n0,0\n1,", XY, "too few fields in line 3"),
    ("x,y,p\n0,0,1\n1,1\n2,2,1\n", XY, "too few fields in line 3"),
    ("x,y\n0,0\n,1\n2,2\n", XY, "no point in line 3"),
    ("n x y\n1 0.5-0.25\n2 0.5 0.25\n", XY, "too few fields in line 2: got 2: 1 0.5-0.25; expected 3"),
    ("1 0.5-0.25 3\n2 0.5-0.25 3", FIRST, "Numbers touch"),
    ("0,5\t1,0\n1,5\t2,0\n", FIRST, "tabs and commas in line 1"),
    ("***** *****\n0 0\n1 1\n", {}, "no point in line 1"),
    ("1.0D-03 0\n1 1\n", {}, "no point in line 1"),
    ("2 2\n0 0\n1 1\n", {}, "counts its points in line 1"),
    ("L1\n 2 2\n0.5 0.5\n1.5 1.5\n", {}, "counts its points in line 2"),
    ("L1\n 2 3\n0 0 7\n1 1 7\nL2\n1 3\n2 2 7\n", FIRST, "counts its points in line 2"),
    ("2\n0 0\n1 1\n", {}, "counts its points in line 1"),
    (",\n0,0\n1,1\n", {}, "an empty row in line 1"),
    ("x,y\n0,0\n1,1\n , \n\n", XY, "an empty row in line 4"),
    ("x,y\n0,0\n1,1\n", {"columns": ["x", "z"]}, "no column z"),
    (b"\x00\xff\xfe" * 100, {}, "cannot be read"),
    ("x;y\n0,5;1,0\n1,5;2,0\n", XY, "semicolons and commas in line 2"),
    ("x y\n0,5 1,0\n1,5 2,0\n", XY, "too many fields in line 2"),
    ("n,x,y\n1,0,0\n2,1,1\n3,2", FIRST, "too few fields in line 4"),
    ("0,5;1.0\n", {"decimal": ","}, "decimal point in line 1: got 1.0"),
    ("Specimen 3\n0,0\n1,1\n2,2\n", XY, "begin the line with #"),
    ("x,y\n0 0\n1 1\n", XY, "as there are column names. With decimal commas"),
]
REMEDIES = [
    ("node,x,y,z\n1,0,0,0\n2,1,1,0\n", {}, "no point in line 2: got 1 0 0 0; .* the 4 columns.* `columns: [x, y]`"),
    ("1 0 0\n2 1 1\n", {}, "the 3 columns to take, by name or by number from 1, e.g. `columns: [1, 2]`."),
    ("X,Y\n0,0\n1,1\n", XY, "no column x: got X, Y; .* the 2 columns to take.* `columns: [X, Y]`."),
]


def test_bad_text(tmp_path):
    for text, options, words in BAD:
        assert words in refused(r"points\.csv", written(tmp_path, text), **options)
    refused("the point in line 3 is not finite", written(tmp_path, "x,y\n0,0\n1,inf\n"), "non_finite")
    refused("no l", written(tmp_path, "0,0\n0,0\n"), "invalid_interface")
    refused("is missing", tmp_path / "none.npy", "result_missing")
    refused("is not a file", tmp_path)


def test_the_remedy_of_missing_columns_is_what_to_write(tmp_path):
    for text, options, told in REMEDIES:
        message = refused(told.replace("[", r"\["), written(tmp_path, text), **options)
        names = message.rpartition("[")[2].partition("]")[0].split(", ")
        assert len(read(tmp_path / "points.csv", columns=[int(n) if n.isdigit() else n for n in names]).points) == 2


@pytest.mark.parametrize(
    "names", ["y,x", '"y","x"', "Y [mm],X [mm]", "row,col", "axis-0,axis-1", "# y,x", "y(mm),x(mm)"]
)
def test_y_before_x_is_told_by_the_names(tmp_path, names):
    path = written(tmp_path, f"{names}\n0,1\n2,3\n")
    refused(r"names its columns .*; expected x before y, or `columns`\. Give `columns: \[", path)
    y, x = names.replace('"', "").removeprefix("# ").split(",")
    np.testing.assert_array_equal(read(path, columns=[x, y]).points, [[1.0, 0.0], [3.0, 2.0]])


ONE, TWO = "0 0\n1 0\n2 1\n", "5 5\n6 5\n7 5\n9 5\n"


def labelled(names="id x y", labels=("1", "2")):
    rows = (f"{label} {row}" for label, part in zip(labels, (ONE, TWO), strict=True) for row in part.splitlines())
    return "\n".join([names, *rows])


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (ONE + "\n" + TWO, {}),
        (f"{ONE}# the other one\n{TWO}", {}),
        (f"*Step = 1\n{ONE}*Step = 2\n{TWO}", {}),
        (labelled(), XY),
        (labelled("t x y", ("0.0", "1.0")), XY),
        (labelled("shape x y", ("left", "right")), XY),
        (labelled("# no names", ("1", "2")), {"columns": [2, 3]}),
    ],
)
def test_several_pieces_or_times_are_refused_or_chosen_from(tmp_path, text, options):
    path = written(tmp_path, text, "points.txt")
    refused("several pieces or times: got 2, of 3, 4 points", path, **options)
    assert read(path, keep="longest", **options).points[0].tolist() == [5.0, 5.0]
    assert read(path, near=[1, 1], **options).points[-1].tolist() == [2.0, 1.0]


def test_of_pieces_of_one_length_none_is_the_longest(tmp_path):
    path = written(tmp_path, "0 0\n0.2 0.15\n1 0\n\n\n2 1\n2.2 1.15\n3 1\n", "blocks.dat")
    refused("`keep: longest` fits several pieces: got 2 of the same size", path, keep="longest")
    assert read(path, near=[2, 1]).points[0].tolist() == [2.0, 1.0]
    refused("not finite", written(tmp_path, f"nan 0\n1 0\n2 1\n\n{TWO}", "a.txt"), "non_finite", keep="longest")


def test_a_column_of_values_or_of_the_numbers_of_points_tells_no_pieces_apart(tmp_path):
    text = "n,p,x,y\n1,0,0,0\n2,0,1,0\n3,0,2,0\n4,7,3,0\n5,7,4,0\n6,7,5,0\n"
    assert len(read(written(tmp_path, text), columns=["x", "y"]).points) == 6
    assert len(read(written(tmp_path, ONE + "\n" + TWO, "a.txt"), sort="x").points) == 7


def test_names_in_quotes_may_hold_what_separates_them_and_a_last_point_closes_but_for_rounding(tmp_path):
    text = '"Points, 0","Points, 1"\n0,0\n1,0\n1,1\n-1e-9,1e-9\n'
    found = read(written(tmp_path, text), columns=["Points, 0", "Points, 1"])
    assert (found.closed, len(found.points)) == (True, 3)


OPTIONS = [
    ("a.csv", {"unit": None}, "result.unit: got nothing"),
    ("a.csv", {"colums": [1, 2]}, "Did you mean columns?"),
    ("a.csv", {"time": "last"}, "no such option for a .csv file"),
    ("a.vtu", {"field": ["u", "v"]}, "the name of point data"),
    ("a.pvd", {"time": {"index": -1}}, "last, {index: 0} or {value: 0.5}"),
    ("a.vtu", {"cells": {"a": "b"}}, "e.g. {region: 3}"),
    ("a.vtu", {"near": [0, 0], "keep": "longest"}, "one of the two"),
    ("a.vtu", {"select": {"x": [1, 0]}}, "[low, high]"),
    ("a.vtu", {"select": {"r": [0, 1]}}, "intervals of x, y or z"),
    ("a.vtu", {"plane": "zx"}, "one of xy, xz, yz"),
    ("a.csv", {"count": 1}, "at least 2"),
]


def test_options_that_cannot_be():
    for file, more, words in OPTIONS:
        with pytest.raises(InvalidInput) as caught:
            made(Reading, {"file": file, "unit": "mm", **more}, "result")
        assert words in str(caught.value)
        assert str(caught.value).startswith("result")


def test_pictures_are_no_tables(tmp_path):
    path = tmp_path / "a.csv"
    for begin, kind in ((b"\x89PNG\r\n\x1a\n", "PNG"), (b"\xff\xd8\xff\xe0", "JPEG")):
        path.write_bytes(begin + bytes(40))
        refused(kind, path)


def test_standard_deviations_have_the_unit_of_the_points(tmp_path):
    """A table of points has them in its columns, or an array."""
    table, path = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 3.0], [2.0, 1.0, 4.0]]), tmp_path / "a.npy"
    np.save(path, table)
    np.savetxt(tmp_path / "a.csv", table, delimiter=",")
    for name in ("a.npy", "a.csv"):
        how = made(Reading, {"file": name, "unit": "um", "sd": 3, "columns": [1, 2]}, "result")
        np.testing.assert_allclose(read_point_sds(tmp_path / name, how), [0.002, 0.003, 0.004])
        np.testing.assert_allclose(read(tmp_path / name, sd=3, columns=[1, 2]).points, table[:, :2])


def test_a_reader_of_ones_own_that_returns_something_else_is_refused(tmp_path, monkeypatch):
    (tmp_path / "a.odd").write_text("")
    (tmp_path / "odd_reader.py").write_text("def load(*given):\n    return {}\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InvalidInput, match=r"got a dict; expected strandline\.readers\.Contents"):
        read(tmp_path / "a.odd", reader="odd_reader:load")


def test_a_reader_of_ones_own_without_the_standard_deviations_of_points_is_refused(tmp_path, monkeypatch):
    text = "import numpy as np\nfrom strandline.readers import Contents\n"
    (tmp_path / "bare_reader.py").write_text(f"{text}def load(*given):\n    return Contents(np.eye(3, 2))\n")
    (tmp_path / "a.odd").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    how = Reading("a.odd", "mm", reader="bare_reader:load", sd=4)
    with pytest.raises(Unreadable, match=r"a\.odd has no point data sd of each point: got none"):
        read_point_sds(tmp_path / "a.odd", how)
