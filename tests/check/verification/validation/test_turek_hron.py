"""Turek and Hron's benchmarks on small meshes; the whole family is in `verification/validation/turek_hron.py`."""

import pytest
from verification.validation.turek_hron import BENCHMARKS, family, solve


@pytest.mark.parametrize(
    ("name", "level", "order", "allowed"),
    [
        ("CSM2", 1, 2, {"ux": 3e-3, "uy": 3e-3}),
        ("FSI1", 0, 3, {"ux": 5e-3, "uy": 1e-2, "drag": 5e-4, "lift": 5e-3}),
    ],
)
def test_published_values(name, level, order, allowed):
    benchmark = BENCHMARKS[name]
    values = solve(benchmark, level, order=order).values
    assert set(values) == set(allowed) == set(benchmark.reference)
    off = {key: abs(values[key] / reference - 1) for key, reference in benchmark.reference.items()}
    assert all(off[key] < allowed[key] for key in allowed), off


def test_beam_converges_at_the_order_its_corners_admit():
    values = [outcome.values["uy"] for outcome in family(BENCHMARKS["CSM2"], order=2, levels=3)]
    ratio = (values[1] - values[0]) / (values[2] - values[1])
    assert 2**2.0 < ratio < 2**3.2
