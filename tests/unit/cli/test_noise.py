"""`strandline noise`: contours in, the key of study.yaml out."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.unit.cli.command_line import Shown, printed, refused

from strandline.interface import Interface, PointErrors
from strandline.studies.keys.observation import Noise
from strandline.studies.noise import build_noise

TRUE = PointErrors(0.002, 0.012)


def outline(number: int = 300) -> Interface:
    """Return an open arch, 1.4 mm long."""
    angle = np.linspace(0.0, np.pi, 2000)
    return Interface.polyline(np.stack([-0.5 * np.cos(angle), 0.4 * np.sin(angle)], axis=1)).resampled(number)


def contours(folder: Path, number: int, *, errors: PointErrors = TRUE, per_mm: float = 1e3, points: int = 300) -> Path:
    """Write contours into files of a folder, in µm."""
    folder.mkdir()
    random = np.random.default_rng(1)
    for k in range(number):
        seen = per_mm * errors.draw(outline(points), random).points
        np.savetxt(folder / f"contour-{k}.csv", seen, delimiter=",", header="x,y", comments="")
    return folder


def stated(shown: str) -> PointErrors:
    """Return the errors that the last line, put into a study, states."""
    (key,) = yaml.safe_load(shown.splitlines()[-1]).values()
    noise = build_noise(Noise.model_validate(key), ())
    assert isinstance(noise, PointErrors)
    return noise


def test_repeats_in_a_folder(tmp_path: Path, capsys: Shown) -> None:
    shown = printed(capsys, "noise", str(contours(tmp_path / "seen", 8)), "--unit", "um")
    assert shown.startswith("8 contours, compared at ")
    assert "correlation length: " in shown
    assert "never show" in shown
    found = stated(shown)
    assert found.sd == pytest.approx(TRUE.sd, rel=0.15)
    assert found.length == pytest.approx(TRUE.length, rel=0.5)


def test_common_errors_become_unknown(tmp_path: Path, capsys: Shown) -> None:
    folder = contours(tmp_path / "seen", 8, errors=PointErrors(0.002, 0.012, shift=0.03))
    shown = printed(capsys, "noise", *sorted(map(str, folder.iterdir())), "--unit", "um")
    assert "common to all points of a contour, sd over the contours: shift " in shown
    assert 0.008 < stated(shown).shift < 0.06


def test_one_contour(tmp_path: Path, capsys: Shown) -> None:
    path = contours(tmp_path / "seen", 1) / "contour-0.csv"
    shown = printed(capsys, "noise", str(path), "--unit", "um", "--window", "200")
    assert shown.startswith("1 contour of 300 points ")
    assert "smoothed over 190 um" in shown
    assert 0.6 * TRUE.sd < stated(shown).sd < 1.4 * TRUE.sd
    assert "unknown: {" not in shown


def test_how_to_read(tmp_path: Path, capsys: Shown) -> None:
    points = TRUE.draw(outline(), np.random.default_rng(2)).points
    rows = [f"{k};{y:.6f};{x:.6f}".replace(".", ",") for k, (x, y) in enumerate(points)]
    path, plain = tmp_path / "seen.txt", tmp_path / "plain.csv"
    path.write_text("\n".join(["n;up;along", *rows]) + "\n", encoding="utf-8")
    np.savetxt(plain, np.round(points, 6), delimiter=",")
    shown = printed(capsys, "noise", str(path), "--unit", "mm", "--read", "columns=[along, up]", "--read", "decimal=,")
    assert shown.splitlines()[-1] == printed(capsys, "noise", str(plain), "--unit", "mm").splitlines()[-1]


def test_contours_that_do_not_belong_together(tmp_path: Path, capsys: Shown) -> None:
    short, mixed, sizes = (
        contours(tmp_path / "a", 2, points=29),
        contours(tmp_path / "b", 2),
        contours(tmp_path / "c", 1),
    )
    lines = (mixed / "contour-1.csv").read_text().splitlines()
    (mixed / "contour-1.csv").write_text("\n".join([*lines, lines[1]]) + "\n")
    other = contours(sizes / "mm", 1, per_mm=1.0) / "contour-0.csv"
    for files, told in (
        ([short], "points of contour 1: got 29"),
        ([mixed], "contour 1 is open, contour 2 closed"),
        ([sizes / "contour-0.csv", other], "sizes of contours of one state"),
    ):
        assert told in refused(capsys, "noise", *map(str, files), "--unit", "um")
