"""Errors of points from the roughness of single contours, within what smoothing can show."""

import numpy as np
import pytest

from strandline.discrepancy import Roughness, errors_from_roughness
from strandline.discrepancy.contours import roughness as module
from strandline.errors import InvalidInput
from strandline.interface import Interface, PointErrors


def ellipse(number: int = 400) -> Interface:
    """Return a closed outline of equal segments, 2.9 mm long."""
    angle = np.linspace(0.0, 2 * np.pi, 4000, endpoint=False)
    fine = np.stack([0.5 * np.cos(angle), 0.4 * np.sin(angle)], axis=1)
    return Interface.polyline(fine, closed=True).resampled(number)


def arch(number: int = 400) -> Interface:
    """Return half of it, open."""
    angle = np.linspace(0.0, np.pi, 4000)
    return Interface.polyline(np.stack([-0.5 * np.cos(angle), 0.4 * np.sin(angle)], axis=1)).resampled(number)


ROUND, OPEN = ellipse(), arch()


def drawn(errors: PointErrors, outline: Interface, number: int) -> list[Roughness]:
    random = np.random.default_rng(1)
    return [errors_from_roughness(errors.draw(outline, random)) for _ in range(number)]


def test_independent_points_have_the_sd_drawn_and_half_the_spacing() -> None:
    for outline, sd in ((ROUND, 2e-4), (OPEN, 0.001)):
        found = drawn(PointErrors(sd), outline, 8)
        assert np.mean([one.errors.sd for one in found]) == pytest.approx(sd, rel=0.08)
        assert all(one.errors.sd == pytest.approx(sd, rel=0.25) for one in found)
        assert np.mean([one.errors.length / one.spacing for one in found]) < 0.8


def correlated(outline: Interface, length: float) -> tuple[float, float]:
    """Return sd and sd² × length, each relative to the true one, in the mean over contours."""
    errors = PointErrors(0.001, length)
    found = [one.errors for one in drawn(errors, outline, 12)]
    sds, lengths = (np.array([getattr(one, name) for one in found]) for name in ("sd", "length"))
    return float(sds.mean() / errors.sd), float((sds**2 * lengths).mean() / (errors.sd**2 * length))


def test_the_level_of_correlated_points_reads_low_by_less_than_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: residuals of the smoothed contour taken as the errors."""
    found = [correlated(*one) for one in ((ROUND, 0.02), (OPEN, 0.01))]
    for sd, level in found:
        assert 0.8 < sd < 1.25
        assert 1 / 3 < level < 1.2
    monkeypatch.setattr(module, "_removed", lambda half, number: np.zeros(number))
    sd, level = correlated(ROUND, 0.02)
    assert sd < 0.97 * found[0][0]
    assert level < 0.8 * found[0][1]


def test_what_smoothing_takes_from_white_noise_is_one_weight_of_it() -> None:
    for half in (4, 9):
        weight = float(module.smoothing_weights(half)[half])
        assert module._removed(half, 40)[0] == pytest.approx(weight)
        assert module._removed(half, 40)[0] + 2 * module._removed(half, 40)[1:].sum() == pytest.approx(1.0)
        assert len(module._removed(half, 5)) == 5


def test_the_outline_itself_is_not_taken_for_roughness() -> None:
    smooth = errors_from_roughness(PointErrors(1e-5).draw(OPEN, np.random.default_rng(2)))
    assert smooth.errors.sd < 1e-4


def test_a_window_is_used_as_given() -> None:
    found = errors_from_roughness(PointErrors(0.001).draw(ROUND, np.random.default_rng(3)), window=0.2)
    assert found.window == pytest.approx(0.2, rel=0.1)
    assert found.errors.sd == pytest.approx(0.001, rel=0.15)


def test_notes_say_where_the_length_cannot_be_trusted() -> None:
    contour = PointErrors(0.001, 0.03).draw(ROUND, np.random.default_rng(4))
    assert "do not trust the length" in errors_from_roughness(contour, window=0.06).notes[-1]
    white = errors_from_roughness(PointErrors(0.001).draw(ROUND, np.random.default_rng(4)), window=0.3)
    assert "do not trust" not in " ".join(white.notes)
    assert "is underestimated" in " ".join(white.notes)


def test_what_shows_no_errors_is_refused() -> None:
    straight = Interface.polyline(np.stack([np.linspace(0, 1, 50), np.zeros(50)], axis=1))
    for contour, window, said in (
        (ellipse(29), None, "points of contour 1: got 29"),
        (ROUND, 0.0, "window"),
        (ROUND, float("nan"), "window"),
        (ROUND, 2.0, "half the contour"),
        (ROUND, 0.035, "got 0.035 mm; expected a length from 0.042"),  # six times 2.84 mm / 400
        (straight, None, "roughness"),
    ):
        with pytest.raises(InvalidInput, match=said):
            errors_from_roughness(contour, window=window)
