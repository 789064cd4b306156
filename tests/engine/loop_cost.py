"""What an update of a law costs, in plain calls of Python in the same process."""

from tests.benchmarks.least import least

UPDATES = 20_000
MOST = 25
"""Plain calls, some 0.2 us each, that an update may cost: 7 were seen, and it has 2 ms."""


def plain(t, values):
    return t * values["displacement"]


def plain_calls(law):
    """How many calls of `plain` take the processor time of one update of `law`."""

    def call(update):
        for k in range(UPDATES):
            update(k * 0.002, {"displacement": 1e-5 * (k % 7)})

    return least(lambda: call(law.update), 1)[0] / least(lambda: call(plain))[0]
