"""Tiles of the lower triangle, in one thread or several."""

import os

import numpy as np
import pytest

from strandline.surrogate import KERNELS
from strandline.surrogate.kernels import tiles

ENOUGH = 520
"""Rows of a triangle that several threads share."""


def test_tiles_cover_the_lower_triangle_once():
    for number in (1, 32, 33, 257, ENOUGH):
        covered = np.zeros((number, number), int)

        def count(tile, covered=covered):
            inside = np.ones((tile[1].stop - tile[1].start, tile[0].stop - tile[0].start))
            covered[tile] += 1
            tiles.clear_above(inside, tile)
            return np.array([inside.sum()])

        total = tiles.add_over_tiles(number, count)
        assert (covered[np.tril_indices(number)] == 1).all()
        assert total == number * (number - 1) / 2


def test_threads_change_no_bit(monkeypatch):
    rng = np.random.default_rng(0)
    x, alpha, precision = rng.normal(size=(ENOUGH, 3)), rng.normal(size=ENOUGH), rng.normal(size=(ENOUGH, ENOUGH))
    for name in ("matern32", "matern52_ard", "matern32_product"):
        count = 3 if KERNELS[name].per_input else 1
        pairs, inverse, found = KERNELS[name].pairs(x, unit=np.ones(count)), np.linspace(0.5, 1.0, count), []
        for threads in ("3", "1"):
            monkeypatch.setenv("OMP_NUM_THREADS", threads)
            out = np.zeros((ENOUGH, ENOUGH), order="F")
            pairs.fill(out, inverse_lengths=inverse, variance=2.0, diagonal=0.1)
            found.append((out, pairs.by_log_lengths(alpha, np.asfortranarray(precision), inverse_lengths=inverse)))
        for three, one in zip(*found, strict=True):
            np.testing.assert_array_equal(three, one)


def test_a_failure_in_a_thread_is_not_lost(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    with pytest.raises(ZeroDivisionError):
        tiles.over_tiles(ENOUGH, lambda tile: 1 / 0)


def test_as_many_threads_as_blas_may_use(monkeypatch):
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    for limit, threads in [("3", 3), ("4,2", 4), ("0", cores), ("many", cores)]:
        monkeypatch.setenv("OMP_NUM_THREADS", limit)
        assert tiles.threads() == threads
    monkeypatch.delenv("OMP_NUM_THREADS")
    assert tiles.threads() == cores
