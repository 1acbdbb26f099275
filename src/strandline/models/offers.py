"""What a forward model may offer in addition to its runs: one protocol each, satisfied by having the method.

All are optional. `undeformed` adds a check and a figure, `on_finer_mesh` adds the mesh error to `strandline check`,
`prepare_runs` is called once before the first run.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.models.protocol import ForwardModel

__all__ = [
    "DrawsFields",
    "KeepsFolders",
    "KnowsUndeformed",
    "PreparesRuns",
    "SolvesOnFinerMesh",
    "UsesNames",
    "prepare_runs",
    "undeformed_interface",
]


@runtime_checkable
class KnowsUndeformed(Protocol):
    """A model that knows its interface before any load.

    strandline then checks the unit and the direction of an observation before the first run, and draws the interface.
    """

    def undeformed(self) -> Interface:
        """Return the undeformed interface, mm."""
        ...


@runtime_checkable
class SolvesOnFinerMesh(Protocol):
    """A model that can run on the next finer mesh: `strandline check` then reports the error of its own mesh."""

    def on_finer_mesh(self, inputs: Mapping[str, float]) -> Mapping[str, Interface]:
        """Return the interfaces by condition, mm.

        Raises:
            ForwardModelError: The run failed.
        """
        ...


@runtime_checkable
class DrawsFields(Protocol):
    """A model that knows velocity, pressure and displacement in its domain: the report then draws them."""

    def fields(self, inputs: Mapping[str, float]) -> Any:
        """Return the fields of a run, in the form of `strandline.models.biofilm.flow_fields.FlowFields`.

        Raises:
            ForwardModelError: The run failed.
        """
        ...


@runtime_checkable
class KeepsFolders(Protocol):
    """A model that keeps the folders of its runs, which are removed otherwise.

    `keep` selects which: ``all``, ``failed`` or ``none``.
    """

    @property
    def keep(self) -> str:
        """Which folders are kept."""
        ...

    def retain(self, workdir: Path, key: str, *, ok: bool) -> Path | None:
        """Move the folder of a finished run to where it is kept and return its new path; None if it is not kept."""
        ...


@runtime_checkable
class PreparesRuns(Protocol):
    """A model with work that all runs share: it is done once, before the first run of a campaign is started.

    What it leaves on disk serves the processes that make the runs; a process that finds nothing there helps itself.
    """

    @property
    def preparation(self) -> str:
        """What is prepared, in the plural; empty if nothing is."""
        ...

    def prepare_runs(self) -> None:
        """Do that work, unless it has been done."""
        ...

    def is_prepared(self, inputs: Mapping[str, float]) -> bool:
        """Return whether a run makes use of it."""
        ...


@runtime_checkable
class UsesNames(Protocol):
    """A model that does not declare its inputs but knows which names it uses, from its templates for example."""

    def require_names(self, unknown: Iterable[str], fixed: Iterable[str]) -> None:
        """Refuse unknown inputs and fixed quantities that the model does not use.

        Raises:
            InvalidInput: There is one, or one is missing.
        """
        ...


def prepare_runs(model: ForwardModel, announce: Callable[[str], object] | None = None) -> None:
    """Let a model prepare its runs, if there is anything to prepare; `announce` is called with what it is before."""
    if isinstance(model, PreparesRuns) and model.preparation:
        if announce is not None:
            announce(model.preparation)
        model.prepare_runs()


def undeformed_interface(model: ForwardModel) -> Interface | None:
    """Return the interface before any load, mm; None if `model` does not know it.

    Raises:
        InvalidInput: `undeformed` is not a method, or does not return an interface.
    """
    if not isinstance(model, KnowsUndeformed):
        return None
    found: Any = model.undeformed() if callable(model.undeformed) else None
    if not isinstance(found, Interface):
        raise InvalidInput(
            f"undeformed interface of {type(model).__name__}",
            value=f"a {type(found).__name__}" if callable(model.undeformed) else "an attribute",
            expected="a method undeformed() that returns an Interface",
            remedy="Correct the model; strandline.testing.simulators checks it.",
        )
    return found
