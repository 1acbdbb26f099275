"""FSI1 of Turek and Hron on a mesh of 3184 elements; the whole family is in `validation/turek_hron.py`."""

from validation.turek_hron import REFERENCE, fsi1


def test_fsi1():
    result = fsi1(0.04, 0.006)
    assert 3000 < result.elements < 3400
    assert abs(result.ux / REFERENCE["ux"] - 1) < 0.005
    assert abs(result.uy / REFERENCE["uy"] - 1) < 0.01
    assert abs(result.drag / REFERENCE["drag"] - 1) < 0.0005
    assert abs(result.lift / REFERENCE["lift"] - 1) < 0.005
