"""Points in text files and arrays."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.readers import Reading, Unreadable, read_interface

POINTS = np.array([[0.0, 0.0], [0.5, 0.25], [1.0, -0.125]])
TABLE = "node, x coord, U1, y coord, U2\n7,0,0,0,0\n8,500,1,250,2\n9,1000,3,-125,4\n"


def read(path: Path, **options: Any) -> Interface:
    return read_interface(path, Reading.from_options({"file": path.name, "unit": "mm", **options}, "result"))


def written(tmp_path: Path, text: str | bytes, name: str = "points.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


@pytest.mark.parametrize("columns", [["x coord", "y coord"], [2, 4]])
def test_columns_by_name_and_number_in_another_unit(tmp_path: Path, columns: list[Any]) -> None:
    found = read(written(tmp_path, TABLE), columns=columns, delimiter=",", unit="um")
    np.testing.assert_allclose(found.points, POINTS, rtol=1e-15)


@pytest.mark.parametrize("text", ["0,0;0,0\n0,5;0,25\n1;-0,125", "# mm\nx, mm;y, mm\n0;0\n5e-1;0,25\n1,0;-0,125\n"])
@pytest.mark.parametrize("options", [{}, {"columns": [1, 2]}, {"delimiter": ";"}])
def test_decimal_commas_are_read_where_they_are_declared(tmp_path: Path, text: str, options: dict[str, Any]) -> None:
    if "x, mm" in text and not options.get("delimiter"):
        text = text.replace(", mm", "")
    np.testing.assert_array_equal(read(written(tmp_path, text), decimal=",", **options).points, POINTS)


@pytest.mark.parametrize("separator", [" ", "\t", "; "])
def test_decimal_commas_between_blanks(tmp_path: Path, separator: str) -> None:
    text = "\n".join(f"{x}{separator}{y}".replace(".", ",") for x, y in POINTS.tolist())
    np.testing.assert_array_equal(read(written(tmp_path, text), decimal=",").points, POINTS)


def test_a_separator_may_end_each_line(tmp_path: Path) -> None:
    found = read(written(tmp_path, "x,y,\n0,0,\n1,1,\n"), columns=["x", "y"], delimiter=",")
    assert len(found.points) == 2


@pytest.mark.parametrize("end", ["", "\n", "\r\n"])
def test_only_what_a_program_writes_must_end_its_last_line(tmp_path: Path, end: str) -> None:
    path = written(tmp_path, f"0,0\n1,1.2{end}")
    how = Reading.from_options({"file": path.name, "unit": "mm"}, "observation")
    assert read_interface(path, how).points[-1].tolist() == [1.0, 1.2]
    assert read_interface(path, replace(how, count=2), ended=True).points[-1].tolist() == [1.0, 1.2]
    if end:
        assert read_interface(path, how, ended=True).points[-1].tolist() == [1.0, 1.2]
        return
    with pytest.raises(
        Unreadable, match=r"points\.csv ends within a line: got 1,1\.2; expected a line break"
    ) as caught:
        read_interface(path, how, ended=True)
    assert caught.value.kind == "result_unreadable"


def test_displacements_are_added(tmp_path: Path) -> None:
    found = read(written(tmp_path, TABLE), columns=["x coord", "y coord"], field=["U1", "U2"], delimiter=",", unit="um")
    np.testing.assert_allclose(found.points, POINTS + np.array([[0, 0], [1, 2], [3, 4]]) / 1000, rtol=1e-15)


@pytest.mark.parametrize("header", ["a b c", "# a b c", "#a b c"])
def test_names_stand_in_a_line_of_their_own_or_in_a_comment(tmp_path: Path, header: str) -> None:
    text = header + "\n" + "\n".join(f"{y!r} 9 {x!r}" for x, y in POINTS.tolist())
    np.testing.assert_array_equal(read(written(tmp_path, text, "points.dat"), columns=["c", "a"]).points, POINTS)


def test_an_outline_closed_by_repeating_its_first_point_is_closed(tmp_path: Path) -> None:
    square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
    found = read(written(tmp_path, "\n".join(f"{x},{y}" for x, y in [*square, square[0]])))
    assert found.closed
    assert found.points.tolist() == square
    assert found.lengths.sum() == 4.0
    assert not read(written(tmp_path, "\n".join(f"{x},{y}" for x, y in square))).closed


def test_points_in_the_order_of_the_nodes_are_sorted(tmp_path: Path) -> None:
    text = "\n".join(f"{x},{y}" for x, y in POINTS[[1, 2, 0]].tolist())
    np.testing.assert_array_equal(read(written(tmp_path, text), sort="x").points, POINTS)


def test_what_cannot_be_seen_is_hidden(tmp_path: Path) -> None:
    """A shadow in the middle and a stray end: the polyline goes on behind them."""
    path = written(tmp_path, "".join(f"{0.1 * k},{k % 3}\n" for k in range(30)))
    found = read(path, hide=[{"x": [0.95, 1.45]}, {"x": [2.85, 9.0]}])
    assert found.points[:, 0] == pytest.approx([0.1 * k for k in (*range(10), *range(15, 29))])
    with pytest.raises(InvalidInput, match=r"a box of `hide` without a point.*boxes are in mm"):
        read(path, hide=[{"x": [0.95, 1.45]}, {"x": [100.0, 200.0]}])
    with pytest.raises(InvalidInput, match=r"outside the boxes of `hide`: got 6; expected at least 10"):
        read(path, hide={"x": [0.55, 9.0]})


def test_a_box_selects_before_the_displacement(tmp_path: Path) -> None:
    text = "x,y,u,v\n0,0,9,0\n1,0,9,0\n2,0,9,0\n3,0,9,0\n"
    found = read(written(tmp_path, text), columns=["x", "y"], field=["u", "v"], select={"x": [0.5, 2.5]})
    np.testing.assert_array_equal(found.points, [[10.0, 0.0], [11.0, 0.0]])


def test_a_box_that_cuts_a_piece_out_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "0,0\n1,0\n2,5\n3,0\n4,0\n")
    with pytest.raises(Unreadable, match=r"cuts the interface into pieces: got the first one ends at \[1.0, 0.0\] mm"):
        read(path, select={"y": [-1, 1]})


def test_arrays(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS.astype(np.float32))
    np.testing.assert_array_equal(read(tmp_path / "a.npy").points, POINTS)
    np.save(tmp_path / "b.npy", np.column_stack([np.arange(3), POINTS]))
    np.testing.assert_array_equal(read(tmp_path / "b.npy", columns=[2, 3]).points, POINTS)


class Trap:
    """An object whose pickle makes a file when it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


def test_a_pickle_is_never_read(tmp_path: Path) -> None:
    trap = np.array([[Trap(tmp_path / "sprung"), 1.0]], dtype=object)
    np.save(tmp_path / "trap.npy", trap, allow_pickle=True)
    with pytest.raises(Unreadable, match=r"trap\.npy cannot be read"):
        read(tmp_path / "trap.npy")
    assert not (tmp_path / "sprung").exists()
    np.load(tmp_path / "trap.npy", allow_pickle=True)
    assert (tmp_path / "sprung").exists()  # the trap works


@pytest.mark.parametrize(
    ("text", "options", "words", "kind"),
    [
        ("x,y\n0,0\n1,", {"columns": ["x", "y"]}, "no point in line 3", "result_unreadable"),
        ("x,y\n0,0\n1,1\n", {"columns": ["x", "z"]}, "no column z", "result_unreadable"),
        ("0,0\n1,1\n", {"columns": ["x", "y"]}, "no line of column names", "result_unreadable"),
        ("x,x\n0,0\n1,1\n", {"columns": ["x", 2]}, "one column called x", "result_unreadable"),
        ("0,0\n1,1\n", {"columns": [1, 3]}, "no point in line 1", "result_unreadable"),
        ("0,0\n1,1\n", {"count": 3}, "got 2; expected 3", "result_unreadable"),
        ("0,0\n1,inf\n", {}, "point 1 of the interface is not finite", "non_finite"),
        (b"\x00\xff\xfe" * 100, {}, "cannot be read", "result_unreadable"),
        (b"\x00" * 100, {}, "holds no points", "result_unreadable"),
        ("", {}, "holds no points", "result_unreadable"),
        ("0,0\n0,0\n", {}, "no length", "invalid_interface"),
        ("x;y\n0,5;1,0\n1,5;2,0\n", {"columns": ["x", "y"]}, "semicolons and commas in line 2", "result_unreadable"),
        ("0,5;1,0\n1,5;2,0\n", {"columns": [1, 2]}, 'give `decimal: ","`', "result_unreadable"),
        ("x y\n0,5 1,0\n1,5 2,0\n", {"columns": ["x", "y"]}, "too many fields in line 2", "result_unreadable"),
        ("x y\n0,5 1,0\n1,5 2,0\n", {"columns": [1, 2]}, "4: 0 5 1 0; expected 2", "result_unreadable"),
        ("# x y\n0,5 1,0\n1,5 2,0\n", {"columns": ["x", "y"]}, "too many fields in line 2", "result_unreadable"),
        ("0 0\n0,5 1\n1 1\n", {"columns": [1, 2]}, "too many fields in line 2", "result_unreadable"),
        ("n,x,y\n1,0,0\n2,1,1\n3,2", {"columns": [1, 2]}, "too few fields in its last line, 4", "result_unreadable"),
        ("0,5;1.0\n", {"decimal": ","}, "decimal point in line 1: got 1.0", "result_unreadable"),
        ("0,1_0\n1,1\n", {}, "no point in line 1", "result_unreadable"),
        ("0,٣\n1,1\n", {}, "no point in line 1", "result_unreadable"),
    ],
    ids=range(21),
)
def test_bad_text(tmp_path: Path, text: str | bytes, options: dict[str, Any], words: str, kind: str) -> None:
    with pytest.raises(Unreadable, match=r"points\.csv") as caught:
        read(written(tmp_path, text), **options)
    assert words in str(caught.value)
    assert caught.value.kind == kind


@pytest.mark.parametrize(
    ("text", "options", "told"),
    [
        (
            "node,x,y,z\n1,0,0,0\n2,1,1,0\n",
            {},
            "no point in line 2: got 1 0 0 0; expected two numbers x, y. Say which of "
            "the 4 columns to take, by name or by number from 1, e.g. `columns: [x, y]`.",
        ),
        ("# node X Y\n1 0 0\n2 1 1\n", {}, "e.g. `columns: [X, Y]`."),
        ("1 0 0\n2 1 1\n", {}, "the 3 columns to take, by name or by number from 1, e.g. `columns: [1, 2]`."),
        (
            "node, x coord, y coord\n1,0,0\n2,1,1\n",
            {},
            "the 3 columns to take, by name or by number from 1, e.g. `columns: [1, 2]`.",
        ),
        (
            "X,Y\n0,0\n1,1\n",
            {"columns": ["x", "y"]},
            "no column x: got X, Y; expected one column called x. Say which of "
            "the 2 columns to take, by name or by number from 1, e.g. `columns: [X, Y]`.",
        ),
        ("x,y\n0,0\n1\n", {}, "no point in line 3: got 1; expected two numbers x, y. Correct the line"),
    ],
    ids=range(6),
)
def test_the_remedy_of_missing_columns_is_what_to_write(
    tmp_path: Path, text: str, options: dict[str, Any], told: str
) -> None:
    with pytest.raises(Unreadable) as caught:
        read(written(tmp_path, text), **options)
    assert told in str(caught.value)
    if "`columns: " in told and "line" in told:
        names = told.rpartition("[")[2].partition("]")[0].split(", ")
        assert len(read(tmp_path / "points.csv", columns=[int(n) if n.isdigit() else n for n in names]).points) == 2


def test_the_remedy_of_an_array_is_what_to_write(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((3, 5)))
    for options in ({}, {"columns": ["x", "y"]}, {"columns": [1, 6]}):
        with pytest.raises(Unreadable, match=r"the 5 columns to take, .* `columns: \[1, 2\]`"):
            read(tmp_path / "a.npy", **options)


@pytest.mark.parametrize("cut", [0, 5, 60, 127, 130, 170])
def test_a_truncated_array(tmp_path: Path, cut: int) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    whole = (tmp_path / "a.npy").read_bytes()
    assert len(whole) == 176
    (tmp_path / "a.npy").write_bytes(whole[:cut])
    with pytest.raises(Unreadable, match=r"a\.npy cannot be read"):
        read(tmp_path / "a.npy")


def test_arrays_that_hold_no_points(tmp_path: Path) -> None:
    for number, array in enumerate([np.zeros(4), np.zeros((3, 3)), np.array([["a", "b"]]), np.zeros((0, 2))]):
        np.save(tmp_path / f"{number}.npy", array)
        with pytest.raises(Unreadable, match="holds no points"):
            read(tmp_path / f"{number}.npy")


def test_what_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(Unreadable, match="is missing") as caught:
        read(tmp_path / "none.npy")
    assert caught.value.kind == "result_missing"
    with pytest.raises(Unreadable, match="is not a file"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("result.csv", "expected keys with values"),
        ({"unit": "mm"}, "result.file: got nothing"),
        ({"file": "a.csv"}, "result.unit: got nothing"),
        ({"file": "a.csv", "unit": "inch"}, "one of mm, um"),
        ({"file": "a.csv", "unit": "mm", "colums": [1, 2]}, "Did you mean columns?"),
        ({"file": "a.csv", "unit": "mm", "columns": [0, 1]}, "by number from 1"),
        ({"file": "a.csv", "unit": "mm", "columns": [True, 2]}, "by number from 1"),
        ({"file": "a.csv", "unit": "mm", "columns": ["x"]}, "two columns"),
        ({"file": "a.csv", "unit": "mm", "time": "last"}, "no such option for a .csv file"),
        ({"file": "a.csv", "unit": "mm", "field": "u"}, "two columns"),
        ({"file": "a.vtu", "unit": "mm", "field": ["u", "v"]}, "the name of point data"),
        ({"file": "a.vtu", "unit": "mm", "time": "last"}, "no such option for a .vtu file"),
        ({"file": "a.pvd", "unit": "mm", "time": "first"}, "last, {index: 0} or {value: 0.5}"),
        ({"file": "a.pvd", "unit": "mm", "time": {"index": -1}}, "last, {index: 0} or {value: 0.5}"),
        ({"file": "a.vtu", "unit": "mm", "cells": {"a": "b"}}, "e.g. {region: 3}"),
        ({"file": "a.vtu", "unit": "mm", "near": [0, 0], "keep": "longest"}, "one of the two"),
        ({"file": "a.vtu", "unit": "mm", "keep": "shortest"}, "longest"),
        ({"file": "a.vtu", "unit": "mm", "select": {"x": [1, 0]}}, "[low, high]"),
        ({"file": "a.vtu", "unit": "mm", "select": {"r": [0, 1]}}, "intervals of x, y or z"),
        ({"file": "a.csv", "unit": "mm", "hide": [{"x": [1, 0]}]}, "[low, high]"),
        ({"file": "a.vtu", "unit": "mm", "hide": [{"x": [0, 1]}]}, "no such option for a .vtu file"),
        ({"file": "a.vtu", "unit": "mm", "block": True}, "a number from 0"),
        ({"file": "a.vtu", "unit": "mm", "plane": "zx"}, "one of xy, xz, yz"),
        ({"file": "a.csv", "unit": "mm", "count": 1}, "at least 2"),
        ({"file": "a.csv", "unit": "mm", "decimal": ";"}, ". or ,"),
        ({"file": "a.csv", "unit": "mm", "decimal": ",", "delimiter": ","}, "another one than the decimal comma"),
        ({"file": "a.vtu", "unit": "mm", "decimal": ","}, "no such option for a .vtu file"),
    ],
)
def test_options_that_cannot_be(options: Any, words: str) -> None:
    with pytest.raises(InvalidInput) as caught:
        Reading.from_options(options, "result")
    assert words in str(caught.value)
    assert str(caught.value).startswith("result")


def test_a_header_that_names_y_before_x_is_not_passed_over(tmp_path: Path) -> None:
    path = written(tmp_path, "y,x\n0,1\n2,3\n")
    with pytest.raises(InvalidInput, match=r"names its columns y, x.*Give `columns: \[x, y\]`"):
        read(path)
    np.testing.assert_array_equal(read(path, columns=["x", "y"]).points, [[1.0, 0.0], [3.0, 2.0]])
