"""Parts side by side on threads that are kept, powers of two against NumPy's, and double precision."""

import os
import threading

import jax
import numpy as np
import pytest

from strandline.foundations import WHOLE, InvalidInput, double, exp2_of_minus, side_by_side, threads, use_double


def test_power_of_two_is_exact_to_2e_14_and_vanishes_where_it_should():
    x = np.concatenate([np.linspace(-900.0, 60.0, 100_001), [899.0, 1e4, 1e300]])
    power = jax.jit(exp2_of_minus, static_argnames="bounded")
    found = np.asarray(power(x, WHOLE, bounded=False))
    assert np.array_equal(power(x[:-3], WHOLE, bounded=True), found[:-3])
    assert found[:-3] == pytest.approx(np.exp2(-x[:-3]), rel=2e-14)
    assert (found[-3:] < 1e-270).all()


def test_where_double_precision_cannot_be_switched_on_it_is_refused():
    with jax.enable_x64(False), pytest.raises(InvalidInput, match="float32"):
        use_double()


@pytest.fixture(params=["1", "3"])
def number(request, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", request.param)
    return int(request.param)


def test_results_come_in_the_order_of_the_parts_and_as_they_are_needed(number):
    assert list(side_by_side(lambda k: k * k, range(50))) == [k * k for k in range(50)]
    assert list(side_by_side(lambda k: k, [])) == []
    drawn = []
    results = side_by_side(lambda k: k, (drawn.append(k) or k for k in range(100)))
    assert [next(results) for _ in range(10)] == list(range(10))
    assert len(drawn) <= 10 + 2 * number


def test_as_many_parts_are_at_work_as_there_are_threads_which_are_kept(number):
    """Each part waits until as many others are at work: fewer threads would never get there.

    New threads for each task would keep memory each that they freed.
    """
    together, names = threading.Barrier(number, timeout=30.0), {threading.current_thread().name}
    for _ in range(20):
        names |= set(side_by_side(lambda _: (together.wait(), threading.current_thread().name)[1], range(2 * number)))
    assert len(names) <= 1 + number


def test_a_part_that_fails_spares_those_behind_it(number):
    done = []

    def task(k):
        done.append(k)
        raise ValueError(k)

    with pytest.raises(ValueError, match=r"^0$"):
        list(side_by_side(task, range(100)))
    assert len(done) <= 2 * number


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore:os.fork:RuntimeWarning")
def test_a_forked_process_has_threads_of_its_own(monkeypatch, number):
    monkeypatch.setattr("strandline.foundations.computing.double", lambda: True)  # JAX does not stand a fork
    assert list(side_by_side(abs, range(9))) == list(range(9))
    child = os.fork()
    if child == 0:
        os._exit(0 if list(side_by_side(abs, range(9))) == list(range(9)) else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_double_precision_of_the_calling_thread_alone_holds_for_all_parts(number):
    with jax.enable_x64(not double()):
        expected = double()
        assert list(side_by_side(lambda _: double(), range(10))) == [expected] * 10


def test_one_rule_for_the_number_of_threads(monkeypatch):
    for limit in ("1", "4", "2,1", "0", "many", ""):
        monkeypatch.setenv("OMP_NUM_THREADS", limit)
        assert threads() >= 1
        if limit[:1] in ("1", "2", "4"):
            assert threads() == int(limit[0])
