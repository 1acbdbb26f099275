"""Conformance suite for simulators: what any `strandline.models.protocol.ForwardModel` must do.

Each check takes a model and the inputs of a run that succeeds, by name.
"""

import contextlib
import pickle
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from strandline import models
from strandline.foundations import InvalidInput
from strandline.interface import Interface
from strandline.runs import RunRecord, RunRequest, attempt
from strandline.testing import checks_of

STEP = 1e-4  # step of finite differences, relative to an input


def made(model: models.ForwardModel, inputs: Mapping[str, float]) -> RunRecord:
    """Return the record of a run in its own folder."""
    with TemporaryDirectory() as folder:
        return attempt(model, RunRequest("conformance", dict(inputs)), Path(folder))


def run(model: models.ForwardModel, inputs: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Return the points by condition; the run must succeed."""
    record = made(model, inputs)
    assert record.ok, f"the run ends as {record.state} ({record.failure_kind}): {record.message}"
    return {name: interface.points for name, interface in record.interfaces.items()}


def check_a_run_yields_its_interfaces(model: models.ForwardModel, inputs: Mapping[str, float]) -> None:
    """A run succeeds, with an interface for each condition that the model declares."""
    for points in run(model, inputs).values():
        assert np.isfinite(points).all(), "a point is not finite"


def check_it_repeats_itself(model: models.ForwardModel, inputs: Mapping[str, float]) -> None:
    """The same inputs give the same interfaces to the bit."""
    first, second = run(model, inputs), run(model, inputs)
    assert all(np.array_equal(first[name], second[name]) for name in first), "a second run gives another interface"


def check_it_leaves_its_inputs_alone(model: models.ForwardModel, inputs: Mapping[str, float]) -> None:
    """The mapping of inputs is unchanged after a run."""
    given = dict(inputs)
    with TemporaryDirectory() as folder:
        model(given, Path(folder))
    assert given == dict(inputs), "a run changes its inputs"


def check_it_writes_in_its_folder_alone(model: models.ForwardModel, inputs: Mapping[str, float]) -> None:
    """A run leaves no file in the current folder, because runs are made side by side."""
    with TemporaryDirectory() as folder:
        work, here = Path(folder) / "work", Path(folder) / "here"
        work.mkdir()
        here.mkdir()
        with contextlib.chdir(here):
            model(dict(inputs), work)
            left = sorted(path.name for path in here.iterdir())
    assert not left, f"a run writes {', '.join(left)} outside its folder"


def check_it_can_be_sent(model: models.ForwardModel, inputs: Mapping[str, float]) -> None:
    """A pickled copy, as worker processes get it, gives the same interfaces and counts as the same model."""
    copy: models.ForwardModel = pickle.loads(pickle.dumps(model))
    assert models.fingerprint(copy) == models.fingerprint(model), "a pickled copy has another fingerprint"
    there, here = run(copy, inputs), run(model, inputs)
    assert all(np.array_equal(there[name], here[name]) for name in here), "a pickled copy gives another interface"


def check_its_inputs_admit_the_run(model: models.ForwardModel, inputs: Mapping[str, float]) -> None:
    """The inputs that it declares are those of the run, which lie in their ranges."""
    declared = {item.name: item for item in models.declared_inputs(model)}
    if declared:
        assert set(declared) == set(inputs), f"it declares {', '.join(declared)}; the run has {', '.join(inputs)}"
    for name, item in declared.items():
        assert item.admits(inputs[name]), f"{name} = {inputs[name]:g} lies outside {item.range_text()}"


def check_sensitivities_are_derivatives(model: models.ForwardModel, inputs: Mapping[str, float]) -> None:
    """Sensitivities, if it offers them, agree with central differences of its interfaces to 1 %."""
    try:
        asked: models.ForwardModel = models.with_sensitivities(model)
    except InvalidInput:
        return
    found = made(asked, inputs).sensitivities
    assert found, "it is asked for sensitivities and returns none"
    for name in inputs:
        step = STEP * (abs(inputs[name]) or 1.0)
        above, below = (run(model, {**inputs, name: inputs[name] + sign * step}) for sign in (1, -1))
        for condition, points in above.items():
            slope = (points - below[condition]) / (2 * step)
            error = np.abs(found[condition][name] - slope).max()
            assert error <= 0.01 * np.abs(slope).max() + 1e-9 / step, f"the sensitivity to {name} is no derivative"


def check_what_it_offers_fits_its_runs(model: models.ForwardModel, inputs: Mapping[str, float]) -> None:
    """The undeformed interface and that of a finer mesh have as many coordinates as those of its runs."""
    dim = next(iter(run(model, inputs).values())).shape[1]
    others = [models.undeformed_interface(model)]
    if isinstance(model, models.SolvesOnFinerMesh):
        others += model.on_finer_mesh(inputs).values()
    for other in others:
        assert other is None or isinstance(other, Interface), f"a {type(other).__name__} is not an interface"
        assert other is None or other.dim == dim, f"an interface with {other.dim} coordinates, not {dim}"


CHECKS: dict[str, Callable[[models.ForwardModel, Mapping[str, float]], None]] = checks_of(globals())
