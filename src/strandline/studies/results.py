"""The result files: whether they can be written at all, and what happens if one of them cannot."""

import io
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from strandline.errors import InvalidInput, ResultsNotWritten
from strandline.report import FIGURES, template
from strandline.studies.folder import POSTERIOR, REPORT

__all__ = ["Results", "require_writers"]


def require_writers() -> None:
    """Refuse to start if the libraries that write posterior.nc, the figures or the report do not work.

    Raises:
        InvalidInput: A library does not work; the message has its reason.
    """
    for name, trial in {POSTERIOR: _try_netcdf, FIGURES: _try_figures, REPORT: _try_page}.items():
        try:
            trial()
        except Exception as error:
            raise InvalidInput(
                f"{name} could not be written at the end",
                value=reason(error),
                expected="the libraries that strandline is installed with",
                remedy="Install strandline again with its dependencies (`pip install --force-reinstall strandline`).",
            ) from error


class Results:
    """Writes the results of a study one by one; one that fails does not keep the others from being written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.missing: dict[str, str] = {}
        self._first: Exception | None = None

    @contextmanager
    def writing(self, name: str) -> Iterator[None]:
        """Note an error inside the block as a failure to write the file `name`, and go on."""
        try:
            yield
        except Exception as error:
            self.failed(name, error)

    def failed(self, name: str, error: Exception) -> None:
        """Note why `name` is missing, and remove an older file of that name: it does not belong to these results."""
        self.missing[name] = reason(error)
        self._first = self._first or error
        with suppress(OSError):
            (self.folder / name).unlink(missing_ok=True)
        if name == FIGURES:
            shutil.rmtree(self.folder / FIGURES, ignore_errors=True)

    def warnings(self) -> list[str]:
        """Return a line for each result that is missing."""
        return [f"{name} could not be written: {why}" for name, why in self.missing.items()]

    def require_all(self, outcome: Any) -> None:
        """Raise if anything is missing.

        Raises:
            ResultsNotWritten: Something is missing; the error carries `outcome`.
        """
        if self.missing:
            raise ResultsNotWritten(self.folder, self.missing, outcome) from self._first


def reason(error: Exception) -> str:
    """Return why something failed, on one line."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")


def _try_netcdf() -> None:
    import h5netcdf

    h5netcdf.File(io.BytesIO(), "w").close()


def _try_figures() -> None:
    from matplotlib.backends import backend_agg, backend_pdf  # noqa: F401


def _try_page() -> None:
    template("report.html.j2")
