"""Triangulated surfaces that tests share."""

from tests.unit.discrepancy.surfaces import divided, sheet, sphere, turned

__all__ = ["divided", "sheet", "sphere", "turned"]
