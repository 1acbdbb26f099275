"""The command line, one file per command or a few; their imports run when one is called.

In: words of the shell. Out: text, exit code 0, 1 (it did not work) or 2 (wrong input). Nobody imports it.
"""

from strandline.cli.main import main

__all__ = ["main"]
