"""Conformance suite for servers of UM-Bridge 1.0: each endpoint, its answers and its errors.

Each check takes one model of a running server. With pytest:

```python
@pytest.mark.parametrize("check", CHECKS.values(), ids=CHECKS.keys())
def test_my_server(check):
    check(ModelUnderTest("http://127.0.0.1:4242", "forward", inputs=[[400.0, 0.3]]))
```

`CHECKS` cover what the protocol specifies, including features that the model does not support. `STRICT_CHECKS` require
an error of the protocol for malformed requests, about which the protocol says nothing.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import httpx

from strandline.testing import checks_of

FEATURES = ("Evaluate", "Gradient", "ApplyJacobian", "ApplyHessian")
TIMEOUT_SECONDS = 60.0


@dataclass(frozen=True)
class ModelUnderTest:
    """A model of a running server, and input blocks at which it can be evaluated and differentiated."""

    url: str
    name: str
    inputs: list[list[float]]

    def get(self, endpoint: str) -> httpx.Response:
        return httpx.get(f"{self.url}/{endpoint}", **self._options)

    def post(self, endpoint: str, content: Any) -> httpx.Response:
        """Return the response to POST, with `content` as JSON; bytes are sent unchanged."""
        body = content if isinstance(content, bytes) else json.dumps(content).encode()
        headers = {"Content-Type": "application/json"}
        return httpx.post(f"{self.url}/{endpoint}", content=body, headers=headers, **self._options)

    def ask(self, endpoint: str, **content: Any) -> Any:
        """Return the answer to a request that must succeed."""
        response = self.post(endpoint, {"name": self.name, "config": {}, **content})
        assert response.status_code == 200, f"{endpoint} is answered with HTTP {response.status_code}"
        return response.json()

    @property
    def input_sizes(self) -> list[int]:
        return list(self.ask("InputSizes")["inputSizes"])

    @property
    def output_sizes(self) -> list[int]:
        return list(self.ask("OutputSizes")["outputSizes"])

    def supports(self, feature: str) -> bool:
        return bool(self.ask("ModelInfo")["support"].get(feature, False))

    @property
    def _options(self) -> dict[str, Any]:
        """Options of httpx; its preparation for TLS would take longer than a request."""
        return {"timeout": TIMEOUT_SECONDS, "trust_env": False, "verify": not self.url.startswith("http:")}

    def request(self, feature: str, **changes: Any) -> dict[str, Any]:
        """Return a valid request for `feature` on block 0, with some of its keys changed."""
        content: dict[str, Any] = {"name": self.name, "config": {}, "input": self.inputs}
        sens, vec = [1.0] * self.output_sizes[0], [1.0] * self.input_sizes[0]
        content |= {
            "Evaluate": {},
            "Gradient": {"outWrt": 0, "inWrt": 0, "sens": sens},
            "ApplyJacobian": {"outWrt": 0, "inWrt": 0, "vec": vec},
            "ApplyHessian": {"outWrt": 0, "inWrt1": 0, "inWrt2": 0, "sens": sens, "vec": vec},
        }[feature]
        return content | changes


ServerCheck = Callable[[ModelUnderTest], None]


def check_info(model: ModelUnderTest) -> None:
    """Info returns the version 1.0 and the names of the models, and nothing else."""
    response = model.get("Info")
    assert response.status_code == 200, f"Info is answered with HTTP {response.status_code}"
    info = _keys(response.json(), {"protocolVersion", "models"}, "Info")
    assert json.dumps(info["protocolVersion"]) in ("1.0", "1"), "the version is not the number 1.0"
    assert all(isinstance(name, str) for name in _list(info["models"], "models")), "a model's name is not a string"
    assert model.name in info["models"], f"{model.name} is not among the models"


def check_model_info(model: ModelUnderTest) -> None:
    """ModelInfo says with true or false which of the four features the model supports."""
    support = _keys(model.ask("ModelInfo"), {"support"}, "ModelInfo")["support"]
    assert isinstance(support, dict), f"support is {support}"
    assert set(support) <= set(FEATURES), f"support is {support}"
    assert all(type(value) is bool for value in support.values()), "support holds other values than true and false"


def check_input_sizes(model: ModelUnderTest) -> None:
    """InputSizes is a list of whole numbers, the sizes of the input blocks."""
    sizes = _keys(model.ask("InputSizes"), {"inputSizes"}, "InputSizes")["inputSizes"]
    assert all(type(size) is int for size in _list(sizes, "inputSizes")), "a size is not a whole number"
    assert sizes == [len(block) for block in model.inputs], f"{sizes} are not the sizes of the inputs given"


def check_output_sizes(model: ModelUnderTest) -> None:
    """OutputSizes is a list of whole numbers, at least one."""
    sizes = _keys(model.ask("OutputSizes"), {"outputSizes"}, "OutputSizes")["outputSizes"]
    assert all(type(size) is int for size in _list(sizes, "outputSizes")), "a size is not a whole number"


def check_sizes_need_no_config(model: ModelUnderTest) -> None:
    """A request may leave `config` out."""
    for endpoint in ("InputSizes", "OutputSizes", "ModelInfo"):
        code = model.post(endpoint, {"name": model.name}).status_code
        assert code == 200, f"{endpoint} without config is answered with HTTP {code}"
    request = model.request("Evaluate")
    del request["config"]
    assert model.post("Evaluate", request).status_code == 200, "Evaluate without config fails"


def check_evaluate(model: ModelUnderTest) -> None:
    """Evaluate yields blocks of numbers of the declared sizes."""
    output = _keys(model.ask("Evaluate", input=model.inputs), {"output"}, "Evaluate")["output"]
    sizes = [len(_numbers(block, "a block of the output")) for block in _list(output, "output")]
    assert sizes == model.output_sizes, f"the output has blocks of {sizes} numbers; {model.output_sizes} declared"


def check_evaluate_repeats(model: ModelUnderTest) -> None:
    """The same inputs yield the same outputs."""
    first, second = (model.ask("Evaluate", input=model.inputs) for _ in range(2))
    assert first == second, "two calls with the same inputs differ"


def check_gradient(model: ModelUnderTest) -> None:
    """Gradient yields a number for each input of its block, and 0 for weights of 0."""
    _require_product(model, "Gradient", model.input_sizes[0], sens=[0.0] * model.output_sizes[0])


def check_apply_jacobian(model: ModelUnderTest) -> None:
    """ApplyJacobian yields a number for each output of its block, and 0 for a vector of 0."""
    _require_product(model, "ApplyJacobian", model.output_sizes[0], vec=[0.0] * model.input_sizes[0])


def check_apply_hessian(model: ModelUnderTest) -> None:
    """ApplyHessian yields a number for each input of its first block, and 0 for a vector of 0."""
    _require_product(model, "ApplyHessian", model.input_sizes[0], vec=[0.0] * model.input_sizes[0])


def check_gradient_and_jacobian_agree(model: ModelUnderTest) -> None:
    """Weights times (Jacobian times vector) equals (weights times Jacobian) times vector."""
    if model.supports("Gradient") and model.supports("ApplyJacobian"):
        vec = [0.5 + k for k in range(model.input_sizes[0])]
        sens = [1.0 / (1 + k) for k in range(model.output_sizes[0])]
        forward = _product(model, "ApplyJacobian", vec=vec)
        backward = _product(model, "Gradient", sens=sens)
        one = math.fsum(s * p for s, p in zip(sens, forward, strict=True))
        other = math.fsum(g * v for g, v in zip(backward, vec, strict=True))
        found = f"{one!r} by ApplyJacobian, {other!r} by Gradient"
        assert math.isclose(one, other, rel_tol=1e-8, abs_tol=1e-300), found


def check_unknown_models(model: ModelUnderTest) -> None:
    """Every endpoint answers ModelNotFound to an unknown model, whatever else the request lacks."""
    for endpoint in ("ModelInfo", "InputSizes", "OutputSizes", *FEATURES):
        _require_error(model.post(endpoint, {"name": "no such model"}), "ModelNotFound", endpoint)


def check_unsupported_features(model: ModelUnderTest) -> None:
    """A feature that the model does not have is answered with UnsupportedFeature, whatever else the request lacks."""
    for feature in FEATURES:
        if not model.supports(feature):
            _require_error(model.post(feature, {"name": model.name}), "UnsupportedFeature", feature)


def check_number_of_blocks(model: ModelUnderTest) -> None:
    """One block too many, or none, is answered with InvalidInput."""
    for blocks in ([*model.inputs, [1.0]], []):
        _refused_everywhere(model, "input", blocks, FEATURES)


def check_sizes_of_blocks(model: ModelUnderTest) -> None:
    """One input too many or too few in a block is answered with InvalidInput."""
    first, *rest = model.inputs
    for block in ([*first, 1.0], first[:-1]):
        _refused_everywhere(model, "input", [block, *rest], FEATURES)


def check_weights_and_vectors(model: ModelUnderTest) -> None:
    """Weights and vectors of the wrong length are answered with InvalidInput."""
    _refused_everywhere(model, "sens", [1.0] * (model.output_sizes[0] + 1), ("Gradient",))
    _refused_everywhere(model, "vec", [1.0] * (model.input_sizes[0] + 1), ("ApplyJacobian",))


def check_blocks_that_do_not_exist(model: ModelUnderTest) -> None:
    """outWrt and inWrt below 0, or beyond the last block, are answered with InvalidInput."""
    outputs, inputs = len(model.output_sizes), len(model.input_sizes)
    for number in (outputs, -1):
        _refused_everywhere(model, "outWrt", number, ("Gradient", "ApplyJacobian", "ApplyHessian"))
    for number in (inputs, -1):
        _refused_everywhere(model, "inWrt", number, ("Gradient", "ApplyJacobian"))
        _refused_everywhere(model, "inWrt1", number, ("ApplyHessian",))
        _refused_everywhere(model, "inWrt2", number, ("ApplyHessian",))


def strict_malformed_json(model: ModelUnderTest) -> None:
    """Anything but a JSON object is answered with InvalidInput."""
    for body in (b"", b"{", b"[]", b"null", b'"text"', b"\xff\xfe", b'{"name": "' + b"[" * 10000, b"[" * 100000):
        response = model.post("Evaluate", body)
        kinds = ("InvalidInput", "ModelNotFound")
        _require_error(response, kinds, f"Evaluate of {body[:20]!r}")


def strict_wrong_types(model: ModelUnderTest) -> None:
    """Text, booleans, null, objects and lists are not numbers; numbers are not lists; indices are whole numbers."""
    first, *rest = model.inputs
    wrong: Any
    for wrong in ("1", True, None, {}, [1.0]):
        _refused_everywhere(model, "input", [[wrong, *first[1:]], *rest], FEATURES)
    for wrong in (1.0, None, "[[1]]", {"0": first}, first):
        _refused_everywhere(model, "input", wrong, FEATURES)
    for wrong in (0.5, "0", None, [0], True):
        _refused_everywhere(model, "outWrt", wrong, ("Gradient", "ApplyJacobian"))
        _refused_everywhere(model, "inWrt", wrong, ("Gradient", "ApplyJacobian"))


def strict_numbers_that_are_not_finite(model: ModelUnderTest) -> None:
    """NaN, infinity and numbers beyond the largest are answered with InvalidInput."""
    first, *rest = model.inputs
    for wrong in (math.nan, math.inf, -math.inf, 10**400):
        _refused_everywhere(model, "input", [[wrong, *first[1:]], *rest], FEATURES)


def strict_missing_keys(model: ModelUnderTest) -> None:
    """A request without a key that it needs is answered with InvalidInput."""
    for feature in FEATURES:
        if model.supports(feature):
            whole = model.request(feature)
            for key in set(whole) - {"name", "config"}:
                rest = {name: value for name, value in whole.items() if name != key}
                _require_error(model.post(feature, rest), "InvalidInput", f"{feature} without {key}")


def strict_large_requests(model: ModelUnderTest) -> None:
    """A request of 11 MB is refused with HTTP 413, and the server keeps running."""
    response = model.post("Evaluate", b" " * 11_000_000)
    assert response.status_code == 413, f"a request of 11 MB is answered with HTTP {response.status_code}"
    check_evaluate(model)


def strict_unknown_endpoints(model: ModelUnderTest) -> None:
    """Another path is answered with 404, another method with 405, both with errors of the protocol."""
    wrong = ((model.post("Nothing", {}), 404), (model.get("Evaluate"), 405), (model.post("Info", {}), 405))
    for response, code in wrong:
        assert response.status_code == code, f"HTTP {response.status_code} instead of {code}"
        assert set(response.json()["error"]) == {"type", "message"}, "not an error of the protocol"


CHECKS: Mapping[str, ServerCheck] = checks_of(globals())
"""What the protocol specifies, by name."""

STRICT_CHECKS: Mapping[str, ServerCheck] = checks_of(globals(), "strict_")
"""What a careful server does in cases that the protocol does not specify, by name."""


def _product(model: ModelUnderTest, feature: str, **changes: Any) -> list[float]:
    response = model.post(feature, model.request(feature, **changes))
    assert response.status_code == 200, f"{feature} is answered with HTTP {response.status_code}"
    return _numbers(_keys(response.json(), {"output"}, feature)["output"], f"the output of {feature}")


def _require_product(model: ModelUnderTest, feature: str, size: int, **nothing: list[float]) -> None:
    """Require so many numbers of a feature that the model supports, and only zeros with `nothing`."""
    if model.supports(feature):
        assert len(_product(model, feature)) == size, f"{feature} does not yield {size} numbers"
        assert not any(_product(model, feature, **nothing)), f"{feature} of 0 is not 0"


def _refused_everywhere(model: ModelUnderTest, key: str, value: Any, features: tuple[str, ...]) -> None:
    """Require InvalidInput of each feature that the model supports if one key of its request is wrong."""
    for feature in features:
        if model.supports(feature):
            shown = repr(value)[:60]
            response = model.post(feature, model.request(feature, **{key: value}))
            _require_error(response, "InvalidInput", f"{feature} with {key} = {shown}")


def _require_error(response: httpx.Response, kind: str | tuple[str, ...], what: str) -> None:
    assert response.status_code == 400, f"{what} is answered with HTTP {response.status_code}, not 400"
    error = _keys(_keys(response.json(), {"error"}, what)["error"], {"type", "message"}, "error")
    kinds = (kind,) if isinstance(kind, str) else kind
    assert error["type"] in kinds, f"{what} is answered with {error['type']}, not {' or '.join(kinds)}"
    assert isinstance(error["message"], str), "the message is not a string"


def _keys(content: Any, expected: set[str], what: str) -> dict[str, Any]:
    keys = set(content) if isinstance(content, dict) else None
    assert keys == expected, f"the keys of {what} are not exactly {expected}"
    return dict(content)


def _list(content: Any, what: str) -> list[Any]:
    assert isinstance(content, list), f"{what} is not a list"
    assert content, f"{what} is an empty list"
    return list(content)


def _numbers(content: Any, what: str) -> list[float]:
    values = _list(content, what)
    numbers = (isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    assert all(numbers), f"{what} holds something other than numbers"
    return values
