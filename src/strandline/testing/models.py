"""Small forward models for tests: a beam with a closed-form interface, and wrappers that misbehave.

They live in an importable module because worker processes must be able to load them.
"""

import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from strandline.foundations import ForwardModelError
from strandline.interface import Interface
from strandline.models import ModelInput, Simulation


@dataclass(frozen=True)
class Cantilever:
    """Outline of a clamped beam, of unit depth, bent by a force at its tip (Euler–Bernoulli, plane stress).

    The centre line sinks by ``w(x) = F x² (3L - x) / (6 E I)`` with ``I = h³/12``; cross-sections stay plane and turn
    by ``w'``. The interface is the outline without its clamped end: along the upper side, around the tip, back along
    the lower side, with so many nodes on each of the two.

    Inputs are Young's modulus ``E`` in Pa and the force ``load`` in N per m of depth, positive upwards; lengths are in
    mm.
    """

    length: float = 1.0
    height: float = 0.1
    nodes: int = 17

    inputs: ClassVar[tuple[ModelInput, ...]] = (
        ModelInput("E", "Pa", 0.0, np.inf, low_included=False, meaning="Young's modulus"),
        ModelInput("load", "N/m", -np.inf, np.inf, meaning="force at the tip, per depth"),
    )

    @property
    def fingerprint(self) -> str:
        return f"test:cantilever-1/{self.length!r}/{self.height!r}/{self.nodes}"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        """Return the outline, mm, and the tip's deflection.

        Raises:
            ForwardModelError: ``nonpositive_stiffness``, or ``large_deflection`` if the tip would move by more than
                the beam's length, so that the linear theory does not hold.
        """
        modulus, load = inputs["E"], inputs["load"]
        if modulus <= 0:
            raise ForwardModelError("nonpositive_stiffness", f"E = {modulus:g} Pa, not above 0", {"E": modulus})
        tip = float(self.deflection(np.array([self.length]), modulus, load)[0])
        if abs(tip) > self.length:
            text = f"the tip would move by {tip:.3g} mm, the beam is {self.length:g} mm long"
            raise ForwardModelError("large_deflection", text, {"tip": tip})
        return Simulation.of(self.outline(modulus, load), {"tip": tip})

    def deflection(self, x: Float[np.ndarray, " point"], modulus: float, load: float) -> Float[np.ndarray, " point"]:
        """Return w at the distances `x` from the clamp, both in mm."""
        return self._flexibility(modulus, load) * x**2 * (3 * self.length - x)

    def outline(self, modulus: float, load: float) -> Interface:
        """Return the deformed outline, mm."""
        x = np.linspace(0.0, self.length, self.nodes)
        slope = self._flexibility(modulus, load) * (6 * self.length * x - 3 * x**2)
        centre, half = self.deflection(x, modulus, load), 0.5 * self.height
        upper = np.stack([x - half * slope, centre + half], axis=1)
        lower = np.stack([x + half * slope, centre - half], axis=1)
        return Interface.polyline(np.concatenate([upper, lower[::-1]]))

    def _flexibility(self, modulus: float, load: float) -> float:
        """Return F / (6 E I) in mm⁻²; N/m over Pa is m, hence the factor 1000."""
        return 1000.0 * load / modulus * 2.0 / self.height**3


@dataclass(frozen=True)
class TwoLoads:
    """A `Cantilever` in two experiments: ``light`` under the force `load`, ``heavy`` under `ratio` times that force.

    The displacement u is proportional to F/E, so ∂u/∂E = -u/E, mm/Pa, and ∂u/∂F = u/F, mm per N/m.
    """

    beam: Cantilever = Cantilever()
    ratio: float = 2.5
    sensitivities: bool = False

    inputs: ClassVar[tuple[ModelInput, ...]] = Cantilever.inputs
    conditions: ClassVar[tuple[str, ...]] = ("light", "heavy")

    @property
    def fingerprint(self) -> str:
        """Changes with the beam and the ratio; sensitivities change no interface."""
        return f"test:two-loads-1/{self.beam.fingerprint}/{self.ratio!r}"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        """Return both outlines, mm, and the tip's deflection under each force.

        Raises:
            ForwardModelError: the beam raises it under either force.
        """
        loads = dict(zip(self.conditions, (inputs["load"], self.ratio * inputs["load"]), strict=True))
        runs = {name: self.beam({"E": inputs["E"], "load": load}, workdir) for name, load in loads.items()}
        tips = {f"tip_{name}": run.diagnostics["tip"] for name, run in runs.items()}
        slopes = self._sensitivities(inputs["E"], loads) if self.sensitivities else {}
        return Simulation({name: run.interface for name, run in runs.items()}, tips, slopes)

    def _sensitivities(self, modulus: float, loads: Mapping[str, float]) -> dict[str, dict[str, Any]]:
        """Return the derivatives from the displacement under a unit force, to avoid a quotient of zeros."""
        unit = self.beam.outline(modulus, 1.0).points - self.beam.outline(modulus, 0.0).points
        factors = dict(zip(self.conditions, (1.0, self.ratio), strict=True))
        return {name: {"E": -loads[name] / modulus * unit, "load": factors[name] * unit} for name in self.conditions}


@dataclass(frozen=True)
class Faulty:
    """A `Cantilever` with a fault, see `_misbehave`, if Young's modulus is above `above`."""

    fault: str = "exception"
    above: float = 500.0

    @property
    def fingerprint(self) -> str:
        return f"{Cantilever().fingerprint}+{self.fault}:E>{self.above!r}"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Any:
        good = Cantilever()(inputs, workdir)
        return _misbehave(self.fault, good, workdir) if inputs["E"] > self.above else good


class SameResults:
    """A wrapper that changes no result of its `base`."""

    base: Any = Cantilever()

    @property
    def fingerprint(self) -> str:
        return str(self.base.fingerprint)


@dataclass(frozen=True)
class Slow(SameResults):
    """`base`, `seconds` later."""

    base: Any = Cantilever()
    seconds: float = 0.1

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Any:
        time.sleep(self.seconds)
        return self.base(inputs, workdir)


@dataclass(frozen=True)
class Counted(SameResults):
    """`base`; writes process id and inputs as a line to ``calls`` in `folder` before a run and to ``ends`` after it."""

    folder: str
    base: Any = Cantilever()

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Any:
        self._append("calls", inputs)
        result = self.base(inputs, workdir)
        self._append("ends", inputs)
        return result

    def _append(self, name: str, inputs: Mapping[str, float]) -> None:
        with (Path(self.folder) / name).open("a", encoding="utf-8") as file:  # written when closed, in one piece
            file.write(f"{os.getpid()} {sorted(inputs.items())}\n")


@dataclass(frozen=True)
class Patient(SameResults):
    """A run with a Young's modulus above 500 Pa first waits until there are `others` files in `folder`.

    The receiver of the records puts them there, and so decides which runs end first.
    """

    folder: str
    others: int
    longest: float = 60.0

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Any:
        deadline = time.monotonic() + (self.longest if inputs["E"] > 500.0 else 0.0)
        while len(list(Path(self.folder).iterdir())) < self.others and time.monotonic() < deadline:
            time.sleep(0.005)
        return self.base(inputs, workdir)


class UnpicklableError(Exception):
    """An exception that can neither be pickled nor rebuilt."""

    def __init__(self, first: object, second: object) -> None:
        self.payload = lambda: (first, second)
        super().__init__("payload that cannot travel")


def _misbehave(fault: str, good: Simulation, workdir: Path) -> Simulation | None:
    """Do what a simulator may do instead of returning its result."""
    match fault:
        case "exit":
            print("about to leave with code 3", flush=True)
            os._exit(3)
        case "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        case "segfault":
            ctypes.string_at(0)
        case "hang":
            print("waiting for nothing", flush=True)
            time.sleep(3600)
        case "hang_in_c":
            ctypes.PyDLL(None).sleep(3600)  # PyDLL keeps the interpreter's lock: no Python thread runs meanwhile
        case "child":
            subprocess.run(["sleep", "3600"], check=True)
        case "nan":
            next(iter(good.interfaces.values())).points[0] = np.nan
        case "exception":
            raise RuntimeError("the matrix is singular")
        case "declared":
            raise ForwardModelError("newton_stalled", "no convergence beyond half of the load", {"load": 0.5})
        case "unpicklable":
            raise UnpicklableError(good, workdir)
        case "leave":
            raise SystemExit(2)
        case "nothing":
            return None
        case "chatter":
            for _ in range(200):
                os.write(1, b"iteration without end " * 4096)
            os.write(1, b"\nthe last words\n")
            raise RuntimeError("said too much")
        case "dirty":
            if any(workdir.iterdir()):
                raise RuntimeError(f"{workdir} is not empty")
            (workdir / "restart.dat").write_bytes(b"0" * 1000)
            os.chdir(workdir)
    return good
