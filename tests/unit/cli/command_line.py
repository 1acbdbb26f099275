"""The command line in this process: what it prints, how it refuses, what it leaves in a folder."""

import pytest

from strandline.cli import main

ALL_SET = ("--set", "E=400", "--set", "tilt=0.02")
HIDDEN = ("-wal", "-shm", ".lock")
"""Ends of the names of files that a reader of a ledger may leave."""


def printed(capsys, *arguments):
    """Return what a command prints; it says nothing else."""
    main(list(arguments))
    shown = capsys.readouterr()
    assert shown.err == ""
    return shown.out


def ends(*arguments):
    """Return the code with which a command ends early."""
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    return int(str(ended.value.code))


def refused(capsys, *arguments):
    """Return the one line with which a command refuses; it prints nothing else and ends with code 2."""
    code = ends(*arguments)
    shown = capsys.readouterr()
    assert (code, shown.out) == (2, ""), shown.err
    return one_line(shown.err)


def one_line(text):
    (line,) = text.splitlines()
    assert line.startswith("strandline: ")
    assert "Traceback" not in line
    return line


def contents(folder):
    """Return what lies in a folder: names and bytes."""
    paths = [path for path in folder.rglob("*") if not path.name.endswith(HIDDEN)]
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in paths}
