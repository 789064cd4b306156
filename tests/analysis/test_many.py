"""Work shared out among processes: the same results in the same order, and a worker that dies takes nothing along."""

import os
import time

import pytest

from pmabench.analysis.many import THREADS, Processes, share


def square(things):
    return [thing * thing for thing in things]


def deadly(things):
    """Ends its process at 7; 3 takes long."""
    for thing in things:
        if thing == 7:
            os._exit(9)
        time.sleep(0.02 * (thing == 3))
    return [(thing, os.environ[THREADS[0]]) for thing in things]


def refused(thing, why):
    return thing, f"lost: {why}"


def test_without_a_pool_all_are_done_here_in_order():
    assert list(share([3, 1, 2], square, refused)) == [(0, 9), (1, 1), (2, 4)]
    assert list(share([], square, refused)) == []


def test_a_worker_that_dies_costs_the_thing_that_killed_it_and_no_other():
    pool = Processes(2)
    try:
        found = dict(share(range(20), deadly, refused, pool))
    finally:
        pool.close()
    assert sorted(found) == list(range(20))
    assert found.pop(7)[1].startswith("lost: A process in the process pool was terminated")
    assert found == {number: (number, "1") for number in found}


class Unlucky:
    """An executor of which the first two submissions fail, as where a worker of a cluster is taken away."""

    width = 2

    def __init__(self):
        self.left = 2

    def executor(self):
        return self

    def submit(self, work, things):
        from concurrent.futures import Future

        future = Future()
        self.left -= 1
        if self.left >= 0:
            future.set_exception(RuntimeError("worker gone"))
        else:
            future.set_result(work(things))
        return future


@pytest.mark.parametrize("count", [1, 5, 300])
def test_what_an_executor_loses_is_tried_again(count):
    found = dict(share(list(range(count)), square, refused, Unlucky()))
    lost = {number for number, result in found.items() if isinstance(result, tuple)}
    assert sorted(found) == list(range(count))
    assert len(lost) <= 1  # one of a batch that failed, tried again while the second failure was still to come
    assert all(found[number] == number * number for number in found if number not in lost)
