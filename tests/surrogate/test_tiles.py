import os

import numpy as np
import pytest

from strandline.surrogate import KERNELS
from strandline.surrogate.kernels import tiles


@pytest.fixture
def several_threads(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.setattr(tiles, "_ENOUGH_FOR_THREADS", 1)


@pytest.mark.parametrize("number", [1, 31, 32, 33, 256, 257, 300])
def test_tiles_cover_the_lower_triangle_once(number):
    covered = np.zeros((number, number), int)

    def count(tile):
        inside = np.ones((tile[1].stop - tile[1].start, tile[0].stop - tile[0].start))
        covered[tile] += 1
        tiles.clear_above(inside, tile)
        return np.array([inside.sum()])

    total = tiles.add_over_tiles(number, count)
    assert (covered[np.tril_indices(number)] == 1).all()
    assert total == number * (number - 1) / 2


@pytest.mark.parametrize("name", KERNELS)
def test_threads_change_no_bit(name, monkeypatch, several_threads):
    rng = np.random.default_rng(0)
    x, alpha, precision = rng.normal(size=(300, 3)), rng.normal(size=300), rng.normal(size=(300, 300))
    count = 3 if KERNELS[name].per_input else 1
    pairs, inverse = KERNELS[name].pairs(x, unit=np.ones(count)), np.linspace(0.5, 1.0, count)
    found = []
    for threads in ("3", "1"):
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        out = np.zeros((300, 300), order="F")
        pairs.fill(out, inverse_lengths=inverse, variance=2.0, diagonal=0.1)
        slopes = pairs.by_log_lengths(alpha, np.asfortranarray(precision), inverse_lengths=inverse)
        found.append((out, slopes))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_array_equal(found[0][1], found[1][1])


def test_a_failure_in_a_thread_is_not_lost(several_threads):
    def fail(tile):
        raise ZeroDivisionError(tile)

    with pytest.raises(ZeroDivisionError):
        tiles.over_tiles(300, fail)


@pytest.mark.parametrize(("limit", "threads"), [("3", 3), ("4,2", 4), ("0", None), ("many", None), (None, None)])
def test_as_many_threads_as_blas_may_use(limit, threads, monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if limit is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", limit)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert tiles.threads() == (threads or cores)
