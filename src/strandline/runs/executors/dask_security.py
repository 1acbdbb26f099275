"""Keys by which the parts of a Dask cluster recognise each other: without a key, nobody can give or take runs."""

import contextlib
import os
import re
import shutil
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from strandline.errors import InvalidInput
from strandline.runs.executors.packing import imported

__all__ = ["key_in_memory", "keys_in_files"]

ROLES = ("client", "scheduler", "worker")


def key_in_memory() -> Any:
    """Return a new key and its certificate, for all parts of a cluster, as a `distributed.Security`.

    Raises:
        InvalidInput: the package ``cryptography`` is not installed.
    """
    from distributed.security import Security

    imported("cryptography")
    return Security.temporary()  # type: ignore[no-untyped-call]


@contextlib.contextmanager
def keys_in_files(parent: Path) -> Iterator[Any]:
    """Yield a new key whose files, readable by this user only, are in their own folder inside `parent`.

    Jobs find the files by their path, so a command line shows only the path. The files are removed at the end; those of
    a driver that was killed are removed by the next one on the same machine.

    Args:
        parent: folder that the nodes see.

    Raises:
        InvalidInput: the files cannot be written; the package ``cryptography`` is not installed.
    """
    security = key_in_memory()
    try:
        parent.mkdir(parents=True, exist_ok=True)
        _remove_forgotten(parent)
        folder = Path(tempfile.mkdtemp(prefix=f"{_prefix()}{os.getpid()}-", dir=parent))  # with mode 0700
    except OSError as error:
        raise _unwritable(parent, error) from None
    try:
        yield _written(security, folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _written(security: Any, folder: Path) -> Any:
    """Return `security` with its key and its certificate in files inside `folder`."""
    from distributed.security import Security

    certificate = _put(folder / "certificate.pem", security.tls_worker_cert)
    key = _put(folder / "key.pem", security.tls_worker_key)
    parts = {f"tls_{role}_cert": certificate for role in ROLES} | {f"tls_{role}_key": key for role in ROLES}
    return Security(require_encryption=True, tls_ca_file=certificate, **parts)  # type: ignore[no-untyped-call]


def _put(path: Path, text: str) -> str:
    """Write a file that no other user may read, not even for a moment."""
    path.touch(mode=0o600, exist_ok=False)
    path.write_text(text, encoding="ascii")
    return str(path)


def _prefix() -> str:
    return f"dask-{socket.gethostname()}-"


def _remove_forgotten(parent: Path) -> None:
    """Remove the keys of drivers on this machine that are gone."""
    name = re.compile(re.escape(_prefix()) + r"(\d+)-[^-]+")  # not the folders of a machine whose name begins like ours
    for folder in parent.iterdir():
        found = name.fullmatch(folder.name)
        if found and not _alive(int(found[1])):
            shutil.rmtree(folder, ignore_errors=True)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def _unwritable(parent: Path, error: OSError) -> InvalidInput:
    return InvalidInput(
        "folder for the keys of a Dask cluster",
        value=f"{parent}: {error.strerror or error}",
        expected="a folder that can be written here and read on the nodes",
        remedy="Name one in Dask's configuration: jobqueue.slurm.shared-temp-directory (or jobqueue.pbs.…).",
    )
