"""The command line, one file a command; a command's imports happen when it is called."""

from strandline.cli.main import main

__all__ = ["main"]
