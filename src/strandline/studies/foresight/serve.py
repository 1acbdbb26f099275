"""A study's forward model and its likelihood as models that others can call by UM-Bridge."""

import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from strandline.foundations import ForwardModelError, require
from strandline.interface import Interface
from strandline.likelihood import InterfaceLikelihood
from strandline.models import ForwardModel
from strandline.models.umbridge import Blocks, ServedModel, flattened
from strandline.runs import RunRecord, RunRequest, WorkerSlot, ended, packed_model, run_key
from strandline.studies.foresight.first_run import require_ok, turned_like
from strandline.studies.load.inputs import check_values
from strandline.studies.load.observed import noisy, require_stated
from strandline.studies.load.study import Study

REMEMBERED = 64

Solve = Callable[[Mapping[str, float]], RunRecord]


class Solver:
    """Makes runs of a model for several threads, each run in one of `workers` processes; the last runs are remembered.

    A crash, or a run of more than `timeout` seconds, costs only that run. The processes start when they are needed.
    """

    def __init__(self, model: ForwardModel, *, workers: int = 1, timeout: float | None = None) -> None:
        self._timeout, self._closed, setup = timeout, threading.Event(), packed_model(model)
        self._slots = [WorkerSlot(setup) for _ in range(workers)]
        self._idle, self._pool = deque(self._slots), ThreadPoolExecutor(workers)
        self._known: dict[str, Future[RunRecord]] = {}
        self._lock = threading.Lock()

    def __call__(self, inputs: Mapping[str, float]) -> RunRecord:
        """Return the record of the run, made now or remembered; InvalidInput if the model cannot be loaded."""
        request = RunRequest(run_key("", inputs), dict(inputs))
        with self._lock:
            if request.key not in self._known:
                self._known[request.key] = self._pool.submit(self._made, request)
            future = self._known[request.key]
            while len(self._known) > REMEMBERED:
                self._known.pop(next(iter(self._known)))
        return future.result()

    def close(self) -> None:
        """End the processes, with the runs that they are making."""
        self._closed.set()
        self._pool.shutdown()
        for slot in self._slots:
            slot.close()

    def _made(self, request: RunRequest) -> RunRecord:
        slot = self._idle.pop()
        record: RunRecord | None = None
        try:
            record = slot.run(request, self._timeout, wanted=lambda: not self._closed.is_set())
        finally:
            self._idle.append(slot)
            if record is None or not record.ok:
                with self._lock:
                    self._known.pop(request.key, None)
        if record is None or self._closed.is_set():
            return ended(request, "killed", "stopped", "stopped with its process")
        return record


@dataclass(frozen=True)
class _Served:
    """The models' functions: the unknown inputs of `study` are the one block of inputs."""

    study: Study
    solve: Solve
    differentiate: Solve | None
    likelihood: InterfaceLikelihood
    outside: bool

    def models(self, example: RunRecord) -> Iterator[ServedModel]:
        """Yield a model of each condition's interface, with the sizes of `example`, and one of the likelihood."""
        dim = (self.study.space.dim,)
        for condition, interface in example.interfaces.items():
            sizes = tuple(len(block) for block in flattened(interface))
            name = f"interface:{condition}" if condition else "interface"
            model = ServedModel(name, dim, sizes, partial(self.interface, condition))
            if self.differentiate is not None:
                gradient, product = partial(self.gradient, condition), partial(self.apply_jacobian, condition)
                model = replace(model, gradient=gradient, apply_jacobian=product)
            yield model
        yield ServedModel("log_likelihood", dim, (1,), self.log_likelihood)

    def interface(self, condition: str, blocks: Blocks) -> Blocks:
        return flattened(self._run(blocks, self.solve).interfaces[condition])

    def log_likelihood(self, blocks: Blocks) -> Blocks:
        return [[self.likelihood(self._run(blocks, self.solve).interfaces)]]

    def gradient(self, condition: str, out: int, into: int, blocks: Blocks, weights: list[float]) -> list[float]:
        """Return weights · d(block)/d(inputs); a surface's triangles, its second block, do not move."""
        jacobian = self._jacobian(condition, blocks)
        product: list[float] = (np.array(weights) @ jacobian if out == 0 else 0.0 * jacobian[0]).tolist()
        return product

    def apply_jacobian(self, condition: str, out: int, into: int, blocks: Blocks, vector: list[float]) -> list[float]:
        """Return d(block)/d(inputs) · vector; zeros for a surface's triangles."""
        if out > 0:
            return [0.0] * len(self.interface(condition, blocks)[out])
        product: list[float] = (self._jacobian(condition, blocks) @ np.array(vector)).tolist()
        return product

    def _jacobian(self, condition: str, blocks: Blocks) -> Float[np.ndarray, "number input"]:
        """Return d(coordinates of the points)/d(unknown inputs), mm per unit of the input."""
        assert self.differentiate is not None
        slopes = self._run(blocks, self.differentiate).sensitivities[condition]
        return np.stack([slopes[name].ravel() for name in self.study.space.names], axis=1)

    def _run(self, blocks: Blocks, solve: Solve) -> RunRecord:
        values = dict(zip(self.study.space.names, blocks[0], strict=True))
        check_values(values, self.study.model, "input")
        for parameter in () if self.outside else self.study.space.parameters:
            value, (low, high) = values[parameter.name], parameter.interval
            expected = f"a number from {low:g} to {high:g}, the box of its prior"
            remedy = "Stay within it, or start the server with `serve --outside`."
            require(low <= value <= high, f"input.{parameter.name}", value, expected, remedy)
        record = solve({**self.study.fixed, **values})
        if not record.ok:
            raise ForwardModelError(record.failure_kind or record.state, record.message or "no message")
        return record


def served_models(
    study: Study, solve: Solve, differentiate: Solve | None = None, *, outside: bool = False
) -> tuple[ServedModel, ...]:
    """Return the models `interface`, or ``interface:CONDITION`` for each condition, and `log_likelihood`.

    One run is made at the medians of the priors, which gives the sizes of the outputs, and one for a synthetic
    observation. All models take one block, the study's unknown inputs in its order. `interface` returns the
    coordinates x0, y0, x1, y1, … of the points, mm, and for a surface its triangles as a second block;
    `log_likelihood` returns log L of the first measure by the true model, without the constant.

    `solve` and `differentiate` make a run, the second with sensitivities; several threads call them at once. Inputs
    outside the boxes of the priors are answered if `outside`.
    """
    medians = study.space.prior_quantiles(np.full((1, study.space.dim), 0.5))[0]
    example = require_ok(solve({**study.fixed, **study.space.as_mapping(medians)}), "at the medians of the priors")
    observed: Mapping[str, Interface] = study.observed
    if study.truth is not None:
        made = require_ok(solve(study.truth), "of the synthetic observation")
        observed = noisy(made.interfaces, study.synthetic_noise)
    observations = turned_like(study.observations(observed), [example])
    require_stated((seen.noise for seen in observations), "strandline serve")
    likelihood = InterfaceLikelihood(observations, study.measure)
    return tuple(_Served(study, solve, differentiate, likelihood, outside).models(example))
