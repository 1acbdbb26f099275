"""The client's side of UM-Bridge 1.0: one request at a time, a limit on everything, and a kind for every failure.

The kinds of `ForwardModelError`: ``connection`` (no server, or it hung up), ``timeout``, ``protocol`` (an answer that
does not follow UM-Bridge or does not belong to this model), ``model_error`` (the server says that its model failed),
``non_finite``. A run that did not reach the server ends ``killed``, so that it is tried again.
"""

import contextlib
import json
import os
import re
import socket
import ssl
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np
from jaxtyping import Float

from strandline.foundations import ForwardModelError, unfit

if TYPE_CHECKING:
    import httpx

PROTOCOL_VERSION = 1.0
LARGEST_ANSWER = 64 * 2**20
"""Bytes of an answer; a million points in space take 60 MB."""
SHOWN_CHARACTERS = 200
LONGEST_LOG = 8192
"""Characters kept of a server's error message after its first line; a served study ends it with the log."""
PATIENCE = 10
"""Multiple of `timeout` for which an evaluation is waited for; one that takes longer may never end."""
NUMBERS_OF_PYTHON = re.compile(r"(?<![\w\"])-?(nan|inf)(?![\w\"])")
"""Numbers that are not finite, as `repr` writes them; servers that build JSON with it send these."""
BLAMES_THE_CALL = ("ModelNotFound", "UnsupportedFeature", "Unauthorized", "Forbidden")
KINDS = {"Busy": "connection", **dict.fromkeys(BLAMES_THE_CALL, "protocol")}
"""What a server says → kind of the failure; anything else is one of the model."""
TOKEN_VARIABLE = "STRANDLINE_TOKEN"
"""Environment variable with the secret of a server started by `strandline serve --token`."""

Vector = Float[np.ndarray, " number"]


@dataclass(frozen=True)
class Description:
    """A server's description of one model: sizes of its input and output blocks, and the features that it supports."""

    input_sizes: tuple[int, ...]
    output_sizes: tuple[int, ...]
    support: Mapping[str, bool]


@dataclass(frozen=True)
class Client:
    """Calls one model of one server, with the same `config` each time.

    Every call has its own connection, so that a load balancer can distribute calls; redirects, proxies and .netrc are
    ignored. The environment variable STRANDLINE_TOKEN, if set, is sent as ``Authorization: Bearer``.

    A server finishes an evaluation even if nobody waits for it, and many servers make one at a time. A call that takes
    longer than `timeout` seconds, up to the last byte of the answer, has failed, but returns only once the server is
    free, so that the next one need not queue.
    """

    url: str
    name: str
    config: Mapping[str, Any] = field(default_factory=dict)
    timeout: float = 600.0

    def __post_init__(self) -> None:
        parts = urlsplit(self.url)
        if parts.scheme not in ("http", "https") or not parts.hostname or parts.query or parts.fragment:
            raise unfit("url", self.url, "e.g. http://127.0.0.1:4242", "Give the server's own address.")
        if not 0 < self.timeout < threading.TIMEOUT_MAX / PATIENCE:
            raise unfit("timeout", self.timeout, "seconds above 0", "Leave it out for 10 minutes.")

    def describe(self) -> Description:
        """Return the server's description of the model; fails without a server, our version, the model, or Evaluate."""
        info = self._mapping("Info", None)
        version, models = info.get("protocolVersion"), info.get("models")
        if version is True or version != PROTOCOL_VERSION:
            raise self._breach(f"speaks version {shortened(version)} of the protocol; expected {PROTOCOL_VERSION}")
        if not isinstance(models, list) or self.name not in models:
            raise self._breach(f"has no model called {self.name!r}; it offers {shortened(models)}")
        support = self._mapping("ModelInfo", {}).get("support")
        if not isinstance(support, dict) or support.get("Evaluate") is not True:
            raise self._breach(f"says that {self.name!r} cannot be evaluated: support is {shortened(support)}")
        sizes = self._sizes("InputSizes", "inputSizes"), self._sizes("OutputSizes", "outputSizes")
        return Description(*sizes, {str(feature): offered is True for feature, offered in support.items()})

    def evaluate(self, blocks: Sequence[Sequence[float]], sizes: Sequence[int]) -> list[Vector]:
        """Return the output blocks, with the `sizes` that the server declared."""
        output = self._mapping("Evaluate", {"input": blocks}).get("output")
        if not isinstance(output, list) or len(output) != len(sizes):
            raise self._breach(f"answered Evaluate with {shortened(output)}; expected a list of {len(sizes)} blocks")
        return [self._vector(block, size, "Evaluate") for block, size in zip(output, sizes, strict=True)]

    def jacobian(
        self, out: int, into: int, blocks: Sequence[Sequence[float]], described: Description
    ) -> Float[np.ndarray, "number input"]:
        """Return d(block `out`)/d(block `into`), by ApplyJacobian for each input, or by Gradient for each output.

        A server that offers both gets fewer calls.
        """
        rows, columns = described.output_sizes[out], described.input_sizes[into]
        few = columns <= rows or not described.support.get("Gradient")
        by_columns = described.support.get("ApplyJacobian", False) and few
        feature, key = ("ApplyJacobian", "vec") if by_columns else ("Gradient", "sens")
        found = []
        for unit in np.eye(columns if by_columns else rows).tolist():
            asked = {"outWrt": out, "inWrt": into, "input": blocks, key: unit}
            found.append(self._derivative(feature, asked, rows if by_columns else columns))
        return np.stack(found, axis=1 if by_columns else 0)

    def gradient(
        self,
        out: int,
        into: int,
        blocks: Sequence[Sequence[float]],
        factors: Float[np.ndarray, " output"],
        described: Description,
    ) -> Vector:
        """Return factors · d(block `out`)/d(block `into`), by a single Gradient."""
        asked = {"outWrt": out, "inWrt": into, "input": blocks, "sens": factors.tolist()}
        return self._derivative("Gradient", asked, described.input_sizes[into])

    def _derivative(self, feature: str, asked: Mapping[str, Any], size: int) -> Vector:
        return self._vector(self._mapping(feature, asked).get("output"), size, feature)

    def _sizes(self, endpoint: str, key: str) -> tuple[int, ...]:
        sizes = self._mapping(endpoint, {}).get(key)
        if not isinstance(sizes, list) or not all(type(size) is int and size >= 0 for size in sizes):
            raise self._breach(f"answered {endpoint} with {key} {shortened(sizes)}; expected a list of whole numbers")
        return tuple(sizes)

    def _vector(self, values: object, size: int, endpoint: str) -> Vector:
        try:
            array = as_vector(values, size)
        except ValueError as error:
            raise self._breach(f"answered {endpoint} with {error}; expected {size} numbers") from None
        if not np.isfinite(array).all():
            wrong = int(np.count_nonzero(~np.isfinite(array)))
            raise ForwardModelError("non_finite", f"{wrong} of {size} numbers of {endpoint} are not finite")
        return array

    def _mapping(self, endpoint: str, content: Mapping[str, Any] | None) -> dict[str, Any]:
        """Return the JSON object that the server answers; `content` None sends a GET request."""
        asked = None if content is None else {"name": self.name, "config": dict(self.config), **content}
        status, body = self._exchange(endpoint, asked)
        answer = _parsed(body)
        error = answer.get("error") if isinstance(answer, dict) else None
        if isinstance(error, dict):
            kind = KINDS.get(str(error.get("type")), "model_error")
            reason, _, log = str(error.get("message")).strip().partition("\n")
            message = f"the server says {shortened(error.get('type'))}: {_told(reason)}"
            lost = kind == "connection"
            raise ForwardModelError(kind, message, state="killed" if lost else None, log=log[-LONGEST_LOG:])
        if status >= 500:
            raise ForwardModelError("model_error", f"HTTP {status} without a reason: {_told(body)}")
        if not 200 <= status < 300:
            raise self._breach(f"answered {endpoint} with HTTP {status}: {_told(body)}")
        if not isinstance(answer, dict):
            raise self._breach(f"answered {endpoint} with no JSON object: {_told(body)}")
        return answer

    def _exchange(self, endpoint: str, asked: Mapping[str, Any] | None) -> tuple[int, bytes]:
        """Return status and body of one request; one that takes more than `timeout` seconds in total is a failure."""
        import httpx

        method, url = "GET" if asked is None else "POST", f"{self.url.rstrip('/')}/{endpoint}"
        verify = ssl.create_default_context() if self.url.startswith("https:") else False
        longest = self.timeout * (PATIENCE if "input" in (asked or ()) else 1)
        limits = httpx.Timeout(longest, connect=self.timeout)
        begun = time.monotonic()
        try:
            with (
                _deadline(longest) as trace,
                httpx.Client(verify=verify, timeout=limits, follow_redirects=False, trust_env=False) as client,
                client.stream(method, url, json=asked, headers=_headers(), extensions={"trace": trace}) as response,
            ):
                answer = response.status_code, self._body(response, endpoint)
        except (httpx.HTTPError, httpx.InvalidURL, OSError) as error:
            raise self._mishap(error, time.monotonic() - begun) from None
        if (seconds := time.monotonic() - begun) >= self.timeout:
            raise self._late(f"it came after {seconds:.3g} s")
        return answer

    def _body(self, response: "httpx.Response", endpoint: str) -> bytes:
        if response.has_redirect_location:
            place = shortened(response.headers["location"])
            raise self._breach(f"redirects {endpoint} to {place}, which is not followed")
        chunks, size = [], 0
        for chunk in response.iter_bytes():
            chunks.append(chunk)
            size += len(chunk)
            if size > LARGEST_ANSWER:
                raise self._breach(f"answers {endpoint} with more than {LARGEST_ANSWER // 2**20} MB")
        return b"".join(chunks)

    def _mishap(self, error: Exception, seconds: float) -> ForwardModelError:
        import httpx

        told = _told(str(error))
        if isinstance(error, httpx.ConnectError | httpx.ConnectTimeout | httpx.UnsupportedProtocol | httpx.InvalidURL):
            message = f"no UM-Bridge server answers at {self.url} ({told or 'in time'}): start it, or correct `url`"
            return ForwardModelError("connection", message, state="killed")
        if isinstance(error, httpx.TimeoutException) or seconds >= self.timeout:
            return self._late(f"none came in {seconds:.3g} s")
        if isinstance(error, httpx.DecodingError):
            return self._breach(f"sends data that cannot be unpacked: {told}")
        message = f"{self.url} broke off: {told or type(error).__name__}"
        return ForwardModelError("connection", message, state="killed")

    def _late(self, found: str) -> ForwardModelError:
        return ForwardModelError("timeout", f"no answer of {self.url} within {self.timeout:g} s; {found}")

    def _breach(self, what: str) -> ForwardModelError:
        return ForwardModelError("protocol", f"the server at {self.url} {what}")


def _headers() -> dict[bytes, bytes]:
    token = os.environ.get(TOKEN_VARIABLE)
    secret = {b"Authorization": b"Bearer " + token.encode()} if token else {}
    return {b"Accept-Encoding": b"identity", **secret}


@contextlib.contextmanager
def _deadline(seconds: float) -> Iterator[Any]:
    """Yield a listener for the connection's events; after `seconds` the connection that it has seen is closed.

    The client's own limits apply to each read from the socket, and a server that sends slowly never exceeds them.
    """
    opened: list[socket.socket] = []

    def trace(event: str, info: Mapping[str, Any]) -> None:
        if event == "connection.connect_tcp.complete":
            opened.append(info["return_value"].get_extra_info("socket"))

    def cut() -> None:
        for connection in opened:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    timer = threading.Timer(seconds, cut)
    timer.daemon = True
    timer.start()
    try:
        yield trace
    finally:
        timer.cancel()


def _parsed(body: bytes) -> Any:
    """Return the JSON in `body`, with Python's nan and inf accepted; None if it is not JSON."""
    text = body.decode("utf-8", "replace")
    for candidate in (text, NUMBERS_OF_PYTHON.sub("NaN", text)):
        with contextlib.suppress(ValueError, RecursionError):
            return json.loads(candidate)
    return None


def as_vector(values: object, size: int) -> Vector:
    """Return a list in JSON as `size` numbers, null of C++ servers as NaN; ValueError says what else it is."""
    if not isinstance(values, list):
        raise ValueError(shortened(values))
    if len(values) != size:
        raise ValueError(f"a block of {len(values)} numbers")
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float | None):
            raise ValueError(f"{shortened(value)} among the numbers")
    try:
        return np.array(values, dtype=np.float64)
    except OverflowError:  # a whole number beyond the largest
        return np.full(size, np.inf)


def _told(text: object) -> str:
    """Return text from outside on one short line, without HTML tags."""
    plain = text[: 20 * SHOWN_CHARACTERS].decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
    return _cut(" ".join(re.sub(r"<[^<>]*>", " ", plain).split()))


def shortened(value: object) -> str:
    """Return the repr of what was sent, cut to one short line."""
    return _cut(repr(value))


def _cut(text: str) -> str:
    return text if len(text) <= SHOWN_CHARACTERS else f"{text[:SHOWN_CHARACTERS]}…"
