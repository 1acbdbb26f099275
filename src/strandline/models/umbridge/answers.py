"""The server's side of UM-Bridge 1.0 as a function: request → status and JSON object."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from strandline.foundations import ForwardModelError, InvalidInput
from strandline.models.umbridge.client import PROTOCOL_VERSION, as_vector, shortened

Blocks = list[list[float]]


@dataclass(frozen=True)
class ServedModel:
    """A model as the protocol sees it: blocks of numbers in, blocks of numbers out.

    `gradient` takes the numbers of an output and an input block, the input blocks, and weights, and yields the weights
    times the Jacobian; `apply_jacobian` likewise the Jacobian times a vector. None: the model does not offer it.

    Every exception of the functions becomes an answer: `InvalidInput` is the caller's mistake, any other the model's
    failure.
    """

    name: str
    input_sizes: tuple[int, ...]
    output_sizes: tuple[int, ...]
    evaluate: Callable[[Blocks], Blocks]
    gradient: Callable[[int, int, Blocks, list[float]], list[float]] | None = None
    apply_jacobian: Callable[[int, int, Blocks, list[float]], list[float]] | None = None

    @property
    def support(self) -> dict[str, bool]:
        """Whether clients may ask for each of UM-Bridge's operations."""
        derivatives = {"Gradient": self.gradient is not None, "ApplyJacobian": self.apply_jacobian is not None}
        return {"Evaluate": True, **derivatives, "ApplyHessian": False}


@dataclass(frozen=True)
class Reply:
    """An HTTP status and the object that is sent with it as JSON."""

    status: int
    content: Mapping[str, Any]


class Rejected(Exception):
    """A request that is answered with an error of the protocol, `answer`."""

    def __init__(self, kind: str, message: str, status: int = 400) -> None:
        self.answer = Reply(status, {"error": {"type": kind, "message": message}})
        super().__init__(message)


def answer(models: Sequence[ServedModel], method: str, path: str, body: bytes) -> Reply:
    """Return the answer to a request; invalid requests and failures of the model are answered too."""
    try:
        return Reply(200, _answered(models, method, path, body))
    except Rejected as refused:
        return refused.answer
    except InvalidInput as error:
        return Rejected("InvalidInput", str(error)).answer
    except ForwardModelError as error:
        return Rejected("ModelError", str(error), 500).answer
    except Exception as error:
        return Rejected("ModelError", f"{type(error).__name__}: {error}", 500).answer


def _answered(models: Sequence[ServedModel], method: str, path: str, body: bytes) -> dict[str, Any]:
    if path not in ("/Info", *ENDPOINTS):
        raise Rejected("NotFound", f"no endpoint {path[:80]}; there are /Info, {', '.join(ENDPOINTS)}", 404)
    if method != (right := "GET" if path == "/Info" else "POST"):
        raise Rejected("InvalidInput", f"{method} {path}: expected {right}", 405)
    if path == "/Info":
        return {"protocolVersion": PROTOCOL_VERSION, "models": [model.name for model in models]}
    asked = _object(body)
    model = next((model for model in models if model.name == asked.get("name")), None)
    if model is None:
        known = ", ".join(model.name for model in models)
        raise Rejected("ModelNotFound", f"no model {shortened(asked.get('name'))}; there are {known}")
    if not model.support.get(path[1:], True):
        raise Rejected("UnsupportedFeature", f"{model.name} does not support {path[1:]}")
    if asked.get("config") not in (None, {}):
        found = shortened(asked["config"])
        raise Rejected("InvalidInput", f"config: got {found}; expected none: the study sets it all")
    return ENDPOINTS[path](model, asked)


def _evaluate(model: ServedModel, asked: Mapping[str, Any]) -> dict[str, Any]:
    output = model.evaluate(_inputs(model, asked))
    sizes = tuple(len(block) for block in output)
    if sizes != model.output_sizes:
        raise Rejected("InvalidOutput", f"{model.name} yields {sizes} numbers here; {model.output_sizes} declared", 500)
    return {"output": [_finite(model, block) for block in output]}


def _product(model: ServedModel, asked: Mapping[str, Any], key: str) -> dict[str, Any]:
    """Answer Gradient, whose weights are ``sens``, or ApplyJacobian, whose vector is ``vec``."""
    out, into = _index(asked, "outWrt", model.output_sizes), _index(asked, "inWrt", model.input_sizes)
    function, size = model.gradient, model.output_sizes[out]
    if key == "vec":
        function, size = model.apply_jacobian, model.input_sizes[into]
    assert function is not None
    vector = _vector(asked.get(key), size, key)
    return {"output": _finite(model, function(out, into, _inputs(model, asked), vector))}


ENDPOINTS: Mapping[str, Callable[[ServedModel, Mapping[str, Any]], dict[str, Any]]] = {
    "/ModelInfo": lambda model, asked: {"support": model.support},
    "/InputSizes": lambda model, asked: {"inputSizes": list(model.input_sizes)},
    "/OutputSizes": lambda model, asked: {"outputSizes": list(model.output_sizes)},
    "/Evaluate": _evaluate,
    "/Gradient": lambda model, asked: _product(model, asked, "sens"),
    "/ApplyJacobian": lambda model, asked: _product(model, asked, "vec"),
    "/ApplyHessian": lambda model, asked: {},  # no model supports it
}
"""Path → function that answers it, given the model that the request names; /Info names none."""


def _object(body: bytes) -> dict[str, Any]:
    try:
        asked = json.loads(body.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise Rejected("InvalidInput", f"the request is not JSON: {error}") from None
    if not isinstance(asked, dict):
        raise Rejected("InvalidInput", f"the request is {shortened(asked)}; expected a JSON object")
    return asked


def _inputs(model: ServedModel, asked: Mapping[str, Any]) -> Blocks:
    blocks, sizes = asked.get("input"), model.input_sizes
    if not isinstance(blocks, list) or len(blocks) != len(sizes):
        found = f"{len(blocks)} blocks" if isinstance(blocks, list) else shortened(blocks)
        raise Rejected("InvalidInput", f"input: got {found}; expected a list of {len(sizes)} block(s)")
    return [_vector(block, size, f"input block {k}") for k, (block, size) in enumerate(zip(blocks, sizes, strict=True))]


def _vector(values: object, size: int, what: str) -> list[float]:
    expected = f"expected a list of {size} finite number(s)"
    try:
        array = as_vector(values, size)
    except ValueError as error:
        raise Rejected("InvalidInput", f"{what}: got {error}; {expected}") from None
    if not np.isfinite(array).all():
        raise Rejected("InvalidInput", f"{what}: got {shortened(values)}; {expected}")
    numbers: list[float] = array.tolist()
    return numbers


def _index(asked: Mapping[str, Any], name: str, sizes: tuple[int, ...]) -> int:
    value = asked.get(name)
    if type(value) is not int or not 0 <= value < len(sizes):
        expected = f"expected a whole number from 0 to {len(sizes) - 1}"
        raise Rejected("InvalidInput", f"{name}: got {shortened(value)}; {expected}")
    return value


def _finite(model: ServedModel, values: Sequence[float]) -> list[float]:
    numbers = [float(value) for value in values]
    if not np.isfinite(numbers).all():
        raise Rejected("InvalidOutput", f"{model.name} yields numbers that are not finite", 500)
    return numbers
