"""The version of strandline."""

__version__ = "0.3.0"
