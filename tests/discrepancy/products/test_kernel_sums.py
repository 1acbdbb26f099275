"""Oracle: all pairs at once in NumPy. The same sum by blocks and compiled, by tiles of all and by tiles with a tree."""

import tracemalloc

import jax
import numpy as np
import pytest

from strandline.discrepancy.products import kernel_sums
from strandline.discrepancy.products.kernel_sums import Nodes, kernel_sum


def nodes(number: int, seed: int, *, dim: int = 3) -> Nodes:
    rng = np.random.default_rng(seed)
    points = rng.random((number, dim))
    points[:, -1] *= 0.1
    return Nodes(points, rng.normal(size=(number, dim)))


def all_pairs(a: Nodes, b: Nodes, width: float) -> float:
    r2 = ((a.points[:, None] - b.points) ** 2).sum(axis=2)
    return float((np.exp(-0.5 * r2 / width**2) * (a.normals @ b.normals.T)).sum())


@pytest.fixture(params=["blocks", "compiled"])
def way(request, monkeypatch):
    monkeypatch.setattr(kernel_sums, "SMALL", 0)
    monkeypatch.setattr(kernel_sums, "_FULL_TILE", 128)
    monkeypatch.setattr(kernel_sums, "_TILE", 32)
    with jax.enable_x64(request.param == "compiled"):
        yield


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("number", [1, 127, 128, 129, 700])
@pytest.mark.parametrize(("width", "reach"), [(0.4, np.inf), (0.02, np.inf), (0.02, 0.18)])
def test_tiles_give_the_sum_over_all_pairs(dim, number, width, reach):
    a, b = nodes(number, 1, dim=dim), nodes(411, 2, dim=dim)
    size = np.abs(a.normals).sum() * np.abs(b.normals).sum()
    assert kernel_sum(a, b, width, reach=reach) == pytest.approx(all_pairs(a, b, width), rel=1e-11, abs=1e-16 * size)
    assert kernel_sum(a, a, width, reach=reach) == pytest.approx(all_pairs(a, a, width), rel=1e-11)


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize(("gathered", "tiles"), [(4000, 3), (300, 5)])
def test_many_batches_give_the_same(monkeypatch, gathered, tiles):
    """Also where the partners alone would put more tiles into a batch than it holds."""
    a, b = nodes(700, 1), nodes(411, 2)
    b = Nodes(np.where(b.points[:, :1] < 0.3, b.points, b.points + 5.0), b.normals)
    monkeypatch.setattr(kernel_sums, "_GATHERED", gathered)
    monkeypatch.setattr(kernel_sums, "_TILES", tiles)
    assert kernel_sum(a, b, 0.02, reach=0.18) == pytest.approx(all_pairs(a, b, 0.02), rel=1e-11)
    assert kernel_sum(a, a, 0.02, reach=0.18) == pytest.approx(all_pairs(a, a, 0.02), rel=1e-11)


@pytest.mark.usefixtures("way")
def test_only_pairs_out_of_reach_may_be_missing():
    """A kernel so wide that every pair counts 1: the sum tells which pairs were taken."""
    a, b, reach = nodes(300, 3), nodes(400, 4), 0.1
    ones = [Nodes(one.points, np.tile([1.0, 0.0, 0.0], (len(one), 1))) for one in (a, b)]
    distances = np.linalg.norm(a.points[:, None] - b.points, axis=2)
    taken = kernel_sum(*ones, 1e6, reach=reach)
    assert (distances <= reach).sum() <= round(taken) < 0.6 * distances.size


@pytest.mark.usefixtures("way")
def test_nodes_without_a_partner_in_reach_count_nothing():
    a, b = nodes(300, 3), nodes(200, 4)
    far = Nodes(b.points + 50.0, b.normals)
    assert kernel_sum(a, far, 0.02, reach=0.2) == 0.0


@pytest.mark.usefixtures("way")
def test_nodes_far_beyond_all_others_count_nothing():
    """Some of one side lie 1000 widths away, others among those of the other side, which are close together."""
    a, b = nodes(200, 3), nodes(300, 4)
    a = Nodes(0.05 * a.points, a.normals)
    b = Nodes(np.where(np.arange(300)[:, None] % 2, 0.05 * b.points, 20.0 + b.points), b.normals)
    assert kernel_sum(a, b, 0.02, reach=np.inf) == pytest.approx(all_pairs(a, b, 0.02), rel=1e-11)
    assert kernel_sum(b, a, 0.02, reach=np.inf) == pytest.approx(all_pairs(a, b, 0.02), rel=1e-11)


@pytest.mark.parametrize("shift", [0.0, 1e6])
@pytest.mark.parametrize("width", [0.5, 0.06, 0.05])
def test_each_pair_counts_to_1e_13_wherever_the_nodes_lie(monkeypatch, shift, width):
    """One node against many far and near, close enough for x·y (0.5, 0.06) and not (0.05), around 0 and far from it."""
    monkeypatch.setattr(kernel_sums, "SMALL", 0)
    places = np.linspace(0.0, 1.0, 257)
    for place in places:
        one = Nodes(np.array([[0.0, 0.0], [1.0, 0.0]]) + shift, np.array([[1.0, 0.0], [0.0, 0.0]]))
        other = Nodes(np.array([[place, 0.0]]) + shift, np.array([[1.0, 0.0]]))
        exact = np.exp(-0.5 * ((other.points[0, 0] - one.points[0, 0]) / width) ** 2)
        assert kernel_sum(one, other, width, reach=np.inf) == pytest.approx(exact, rel=1e-13, abs=1e-200)


@pytest.mark.parametrize(("width", "reach"), [(0.4, np.inf), (0.02, 0.18)])
@pytest.mark.parametrize("double", [False, True])
def test_the_number_of_threads_does_not_change_a_bit(monkeypatch, width, reach, double):
    a, b = nodes(3000, 1), nodes(2000, 2)
    found = []
    for threads in ("1", "2", "3"):
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        with jax.enable_x64(double):
            found.append([kernel_sum(a, other, width, reach=reach) for other in (a, b)])
    assert found[0] == found[1] == found[2]
    assert found[0][1] == pytest.approx(all_pairs(a, b, width), rel=1e-11)


def test_memory_does_not_grow_as_the_pairs(monkeypatch):
    a, b = nodes(20_000, 1), nodes(20_000, 2)
    tracemalloc.start()
    try:
        kernel_sum(a, b, 0.004, reach=0.03)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 0.05 * 8 * len(a) * len(b)
