"""Work in the pool: all of it done, in order, also where it is split again; rows counted into order."""

import threading

import numpy as np
import pytest

from gpdf_service.fields import threads
from gpdf_service.fields.order import order_by
from gpdf_service.fields.threads import run_beside, run_chunked, run_parallel

DEADLINE_S = 60.0


def test_work_that_is_split_again_in_the_pool_ends(monkeypatch):
    monkeypatch.setattr(threads, "worker_count", lambda: 4)
    made = []

    def nested():
        def inner(i):
            return run_beside(lambda: run_parallel(lambda j: 10 * i + j, range(10)), lambda: i)

        made.extend(run_parallel(inner, range(20)))

    runner = threading.Thread(target=nested, daemon=True)
    runner.start()
    runner.join(DEADLINE_S)
    assert not runner.is_alive()
    assert made == [(list(range(10 * i, 10 * i + 10)), i) for i in range(20)]


def test_ranges_tile_all_there_is():
    for count in (0, 1, threads.MIN_CHUNK, 100_003):
        seen = np.zeros(count, np.int64)

        def add(begin, end, seen=seen):
            seen[begin:end] += 1

        run_chunked(add, count)
        assert (seen == 1).all()


def test_an_error_in_a_helper_or_beside_is_raised(monkeypatch):
    monkeypatch.setattr(threads, "worker_count", lambda: 4)

    def work(i):
        if i == 13:
            raise ValueError("thirteen")

    with pytest.raises(ValueError, match="thirteen"):
        run_parallel(work, range(40))
    with pytest.raises(ValueError, match="thirteen"):
        run_beside(lambda: 1, lambda: work(13))


@pytest.mark.parametrize("most", [1, 5, 2**11, 2**23, 2**40])
def test_rows_are_in_the_order_of_their_keys_and_equal_ones_as_they_came(most):
    key = np.random.default_rng(most).integers(0, most, 3000)
    np.testing.assert_array_equal(order_by(key), np.argsort(key, kind="stable"))
    assert len(order_by(key[:0])) == 0
