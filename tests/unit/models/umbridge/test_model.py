"""Options of a model behind UM-Bridge, its fingerprint, and how numbers become an interface."""

from typing import Any

import numpy as np
import pytest

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.protocol import declared_inputs, with_sensitivities
from strandline.models.umbridge.layout import Layout, flattened
from strandline.models.umbridge.model import UMBridge, UMBridgeModel

TRIANGLES = np.array([0.0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3])
CORNERS = np.array([0.0, 0, 0, 4, 0, 0, 0, 1, 0, 0, 0, 1])


def model(**options: Any) -> UMBridgeModel:
    return UMBridge.from_options(**{"url": "http://127.0.0.1:1", "name": "beam", "inputs": ["E", "load"]} | options)


def test_the_address_is_no_part_of_the_fingerprint_and_what_changes_results_is() -> None:
    one = model()
    assert model(url="http://localhost:2/", timeout=5.0).fingerprint == one.fingerprint
    assert with_sensitivities(one).fingerprint == one.fingerprint
    others: list[dict[str, Any]] = [
        {"name": "other"},
        {"inputs": ["load", "E"]},
        {"inputs": [["E"], ["load"]]},
        {"config": {"mesh": 2}},
        {"version": 2},
        {"unit": "um"},
        {"interface": {"shape": "columns"}},
    ]
    assert len({one.fingerprint, *(model(**changes).fingerprint for changes in others)}) == len(others) + 1


def test_units_are_declared_where_all_are_given() -> None:
    declared = declared_inputs(model(inputs=[{"E": "Pa"}, {"nu": 1}]))
    assert [(item.name, item.unit) for item in declared] == [("E", "Pa"), ("nu", "1")]
    assert declared_inputs(model(inputs=[{"E": "Pa"}, "nu"])) == ()


REFUSED: list[tuple[dict[str, Any], str]] = [
    *(({"url": url}, "url") for url in ("127.0.0.1:4242", "ftp://127.0.0.1", "http://")),
    *(({"timeout": seconds}, "timeout") for seconds in (0.0, float("nan"))),
    *(({"inputs": names}, "inputs") for names in ([], "E", ["E", "E"], [["E"], []], [1])),
    ({"unit": "inch"}, "unit"),
    ({"config": [1]}, "config"),
    ({"config": {"a": float("nan")}}, "config"),
    ({"interface": {"shape": "mesh"}}, "interface.shape"),
    ({"interface": {"dim": 4}}, "interface.dim"),
    ({"interface": {"dim": 3, "closed": True}}, "interface.closed"),
    ({"interface": {"form": "points"}}, "interface"),
]


def test_wrong_options_are_refused_before_anything_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    for options, what in REFUSED:
        with pytest.raises(InvalidInput) as caught:
            model(**options)
        assert caught.value.what == what
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InvalidInput, match=r'pip install "strandline\[umbridge\]"'):
        model()


def test_blocks_become_an_interface() -> None:
    points = Layout().interface([np.array([0.0, 0.0, 1.0, 2.0])], 1e-3)
    np.testing.assert_array_equal(points.points, [[0.0, 0.0], [1e-3, 2e-3]])
    assert flattened(points) == [[0.0, 0.0, 1e-3, 2e-3]]
    columns = Layout("columns", closed=True).interface([np.array([0.0, 1, 1]), np.array([0.0, 0, 1])], 1.0)
    assert columns.closed
    np.testing.assert_array_equal(columns.points, [[0, 0], [1, 0], [1, 1]])
    surface = Layout(dim=3).interface([CORNERS, TRIANGLES], 1.0)
    assert surface.closed
    np.testing.assert_array_equal(surface.cells, TRIANGLES.reshape(-1, 3))
    assert flattened(surface) == [CORNERS.tolist(), TRIANGLES.tolist()]


def test_blocks_that_hold_no_interface_are_told() -> None:
    for layout, blocks, words in (
        (Layout(), [], "at least 1 blocks"),
        (Layout(), [np.ones(3)], "2 numbers for each point"),
        (Layout("columns"), [np.ones(3)], "at least 2 blocks"),
        (Layout("columns"), [np.ones(3), np.ones(2)], "as many numbers"),
        (Layout(dim=3), [CORNERS], "a block with the triangles"),
        (Layout("columns", dim=3), [np.arange(4.0)] * 4, "three whole numbers"),
        (Layout(dim=3), [CORNERS, TRIANGLES + 0.5], "three whole numbers"),
    ):
        with pytest.raises(ForwardModelError, match=words) as caught:
            layout.interface(blocks, 1.0)
        assert caught.value.kind == "protocol"
