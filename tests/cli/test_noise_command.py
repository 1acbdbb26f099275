"""`strandline noise`: contours in, the key of study.yaml out."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from strandline.cli import main
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


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    main(["noise", *arguments])
    shown = capsys.readouterr()
    assert shown.err == ""
    return shown.out


def stated(shown: str) -> PointErrors:
    """Return the errors that the last line, put into a study, states."""
    (key,) = yaml.safe_load(shown.splitlines()[-1]).values()
    noise = build_noise(Noise.model_validate(key), ())
    assert isinstance(noise, PointErrors)
    return noise


def test_repeats_in_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = printed(capsys, str(contours(tmp_path / "seen", 8)), "--unit", "um")
    assert shown.startswith("8 contours, compared at ")
    assert "correlation length: " in shown
    assert "never show" in shown
    found = stated(shown)
    assert found.sd == pytest.approx(TRUE.sd, rel=0.15)
    assert found.length == pytest.approx(TRUE.length, rel=0.5)


def test_common_errors_become_unknown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    errors = PointErrors(0.002, 0.012, shift=0.03)
    folder = contours(tmp_path / "seen", 8, errors=errors)
    shown = printed(capsys, *sorted(map(str, folder.iterdir())), "--unit", "um")
    assert "common to all points of a contour, sd over the contours: shift " in shown
    assert 0.008 < stated(shown).shift < 0.06


def test_one_contour(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = contours(tmp_path / "seen", 1) / "contour-0.csv"
    shown = printed(capsys, str(path), "--unit", "um", "--window", "200")
    assert shown.startswith("1 contour of 300 points ")
    assert "smoothed over " in shown
    assert 0.6 * TRUE.sd < stated(shown).sd < 1.4 * TRUE.sd
    assert "unknown: {" not in shown


def test_how_to_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = TRUE.draw(outline(), np.random.default_rng(2)).points
    rows = [f"{k};{y:.6f};{x:.6f}".replace(".", ",") for k, (x, y) in enumerate(points)]
    path = tmp_path / "seen.txt"
    path.write_text("\n".join(["n;up;along", *rows]) + "\n", encoding="utf-8")
    plain = tmp_path / "plain.csv"
    np.savetxt(plain, np.round(points, 6), delimiter=",")
    shown = printed(capsys, str(path), "--unit", "mm", "--read", "columns=[along, up]", "--read", "decimal=,")
    assert shown.splitlines()[-1] == printed(capsys, str(plain), "--unit", "mm").splitlines()[-1]


def short(folder: Path) -> list[str]:
    return [str(contours(folder, 2, points=29)), "--unit", "um"]


def mixed(folder: Path) -> list[str]:
    contours(folder, 2)
    path = folder / "contour-1.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, lines[1]]) + "\n")
    return [str(folder), "--unit", "um"]


def other_units(folder: Path) -> list[str]:
    contours(folder, 1)
    contours(folder / "mm", 1, per_mm=1.0)
    return [str(folder / "contour-0.csv"), str(folder / "mm" / "contour-0.csv"), "--unit", "um"]


def no_unit(folder: Path) -> list[str]:
    return [str(contours(folder, 1) / "contour-0.csv"), "--unit", "inch"]


def empty(folder: Path) -> list[str]:
    folder.mkdir()
    return [str(folder), "--unit", "um"]


def missing(folder: Path) -> list[str]:
    return [str(folder / "nothing.csv"), "--unit", "um"]


def window_of_several(folder: Path) -> list[str]:
    return [str(contours(folder, 2)), "--unit", "um", "--window", "100"]


def no_option(folder: Path) -> list[str]:
    return [str(contours(folder, 1) / "contour-0.csv"), "--unit", "um", "--read", "columns"]


def unknown_option(folder: Path) -> list[str]:
    return [str(contours(folder, 1) / "contour-0.csv"), "--unit", "um", "--read", "colums=[x,y]"]


@pytest.mark.parametrize(
    ("case", "said"),
    [
        (short, "points of contour 1: got 29"),
        (mixed, "contour 1 is open, contour 2 closed"),
        (other_units, "sizes of contours of one state"),
        (no_unit, "inch"),
        (empty, "without files"),
        (missing, "nothing.csv"),
        (window_of_several, "--window"),
        (no_option, "NAME=VALUE"),
        (unknown_option, "Did you mean columns?"),
    ],
    ids=lambda case: getattr(case, "__name__", ""),
)
def test_bad_input_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], case: Callable[[Path], list[str]], said: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["noise", *case(tmp_path / "seen")])
    shown = capsys.readouterr()
    assert (ended.value.code, shown.out) == (2, "")
    assert len(shown.err.splitlines()) == 1
    assert said in shown.err
