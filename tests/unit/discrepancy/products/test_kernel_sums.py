"""Oracle: all pairs at once in NumPy. The same sum by blocks and compiled, by tiles of all and by tiles with a tree."""

import jax
import numpy as np
import pytest

from strandline.discrepancy.kernel_integrals import BLOCK, Nodes, Sizes, kernel_sum

SMALL_TILES = Sizes(small=0, tile=32, full_tile=128)


def nodes(number: int, seed: int, *, dim: int = 3) -> Nodes:
    rng = np.random.default_rng(seed)
    points = rng.random((number, dim))
    points[:, -1] *= 0.1
    return Nodes(points, rng.normal(size=(number, dim)))


def all_pairs(a: Nodes, b: Nodes, width: float) -> float:
    r2 = ((a.points[:, None] - b.points) ** 2).sum(axis=2)
    return float((np.exp(-0.5 * r2 / width**2) * (a.normals @ b.normals.T)).sum())


BOTH_WAYS = pytest.mark.parametrize("compiled", [False, True], ids=["blocks", "compiled"])
MANY, FEW = (Sizes(small=0, tile=32, full_tile=128, tiles=n, gathered=g) for n, g in ((3, 4000), (5, 300)))
"""In the second, the partners alone would put more tiles into a batch than it holds."""
TASKS = [
    (129, 3, 0.4, np.inf, SMALL_TILES),
    (129, 2, 0.02, np.inf, SMALL_TILES),
    (700, 3, 0.02, 0.18, MANY),
    (700, 3, 0.02, 0.18, FEW),
    (1, 3, 0.4, np.inf, SMALL_TILES),
    (128, 3, 0.02, np.inf, SMALL_TILES),
    (700, 2, 0.02, 0.18, SMALL_TILES),
]


@pytest.mark.parametrize(("compiled", "tasks"), [(True, TASKS[:3]), (False, TASKS)], ids=["compiled", "blocks"])
def test_tiles_give_the_sum_over_all_pairs(compiled, tasks):
    for number, dim, width, reach, sizes in tasks:
        a, b = nodes(number, 1, dim=dim), nodes(411, 2, dim=dim)
        size = np.abs(a.normals).sum() * np.abs(b.normals).sum()
        with jax.enable_x64(compiled):
            found = [kernel_sum(a, one, width, reach=reach, sizes=sizes) for one in (b, a)]
        assert found[0] == pytest.approx(all_pairs(a, b, width), rel=1e-11, abs=1e-16 * size)
        assert found[1] == pytest.approx(all_pairs(a, a, width), rel=1e-11)
    a, b = nodes(300, 1), nodes(411, 2)  # few pairs, which are summed in blocks
    assert len(a) * len(b) > BLOCK
    assert kernel_sum(a, b, 0.1, reach=np.inf) == pytest.approx(all_pairs(a, b, 0.1), rel=1e-11)


@BOTH_WAYS
def test_only_pairs_out_of_reach_may_be_missing(compiled):
    """A kernel so wide that every pair counts 1: the sum tells which pairs were taken."""
    a, b, reach = nodes(300, 3), nodes(411, 4), 0.1
    ones = [Nodes(one.points, np.tile([1.0, 0.0, 0.0], (len(one), 1))) for one in (a, b)]
    distances = np.linalg.norm(a.points[:, None] - b.points, axis=2)
    with jax.enable_x64(compiled):
        taken = kernel_sum(*ones, 1e6, reach=reach, sizes=SMALL_TILES)
        assert kernel_sum(a, Nodes(b.points + 50.0, b.normals), 0.02, reach=0.2, sizes=SMALL_TILES) == 0.0
    assert (distances <= reach).sum() <= round(taken) < (0.6 if compiled else 1.1) * distances.size


@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_each_pair_counts_to_1e_13_wherever_the_nodes_lie(shift):
    """One node against many far and near, close enough for x·y (0.5, 0.06) and not (0.05), around 0 and far from it."""
    one = Nodes(np.array([[0.0, 0.0], [1.0, 0.0]]) + shift, np.array([[1.0, 0.0], [0.0, 0.0]]))
    for width in (0.5, 0.06, 0.05):
        for place in np.linspace(0.0, 1.0, 65) + shift:
            other = Nodes(np.array([[place, shift]]), np.array([[1.0, 0.0]]))
            found = kernel_sum(one, other, width, reach=np.inf, sizes=SMALL_TILES)
            assert found == pytest.approx(np.exp(-0.5 * ((place - shift) / width) ** 2), rel=1e-13, abs=1e-200)


@BOTH_WAYS
@pytest.mark.parametrize(("width", "reach"), [(0.4, np.inf), (0.02, 0.18)])
def test_the_number_of_threads_does_not_change_a_bit(monkeypatch, width, reach, compiled):
    a, b, found = nodes(700, 1), nodes(411, 2), []
    for threads in ("1", "2", "3"):
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        with jax.enable_x64(compiled):
            found.append([kernel_sum(a, other, width, reach=reach, sizes=SMALL_TILES) for other in (a, b)])
    assert found[0] == found[1] == found[2]
