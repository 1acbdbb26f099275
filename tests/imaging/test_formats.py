"""The scan that tests of stacks write."""

from tests.unit.imaging.files import scan

__all__ = ["scan"]
