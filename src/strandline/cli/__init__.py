"""The command line, one file per command; a command's imports run when it is called."""

from strandline.cli.main import main

__all__ = ["main"]
