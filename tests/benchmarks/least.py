"""Processor time of a piece of work: the least of some turns, which the rest of the machine disturbed least."""

import time


def least(work, times=3):
    """Least processor time [s] of `times` calls of `work`, and what the last one returned."""
    took = []
    for _ in range(times):
        began = time.process_time()
        found = work()
        took.append(time.process_time() - began)
    return min(took), found
