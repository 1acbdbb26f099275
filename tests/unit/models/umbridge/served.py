"""A model that is served: two inputs x, three outputs (x0², x0 x1, x1), and what it cannot do."""

import threading
from contextlib import contextmanager

from strandline.foundations import ForwardModelError, InvalidInput
from strandline.models.umbridge.answers import ServedModel
from strandline.models.umbridge.server import UMBridgeServer

AT = [[0.5, -2.0]]
TOKEN = "0123456789abcdef"


def whole(blocks):
    x, y = blocks[0]
    if x > 1:
        raise ForwardModelError("singular", "the matrix is singular")
    if x < -1:
        raise InvalidInput("x", value=x, expected="at least -1", remedy="Choose another.")
    if x == 1:
        raise ZeroDivisionError("by nothing")
    return [[x * x, x * y, y]]


WHOLE = ServedModel(
    "whole",
    (2,),
    (3,),
    whole,
    gradient=lambda out, into, b, s: [2 * b[0][0] * s[0] + b[0][1] * s[1], b[0][0] * s[1] + s[2]],
    apply_jacobian=lambda out, into, b, v: [2 * b[0][0] * v[0], b[0][1] * v[0] + b[0][0] * v[1], v[1]],
)
BARE = ServedModel("bare", (2,), (3,), whole)


@contextmanager
def running(server):
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def served(*models, **options):
    return running(UMBridgeServer(models, port=0, **options))
