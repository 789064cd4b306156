"""Signals of the operator: the first cause, and what further ones end once the safe state has begun (S3)."""

import signal

import pytest

from pmabench.engine.ending import Signals

INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP


@pytest.mark.parametrize(
    ("before", "within", "levels"),
    [
        ((), (INT,), [1]),
        ((), (INT, INT), [1, 2]),
        ((), (INT, INT, INT), [1, 2, 2]),
        ((), (TERM,), [2]),
        ((), (HUP, INT), [1, 2]),
        ((INT,), (INT,), [1]),
        ((INT, INT), (INT, INT), [1, 2]),
        ((TERM,), (INT, TERM), [1, 2]),
    ],
)
def test_a_second_ctrl_c_in_the_safe_state_or_a_sigterm_ends_its_last_wait(before, within, levels):
    """Those before it are its cause, and shorten nothing."""
    with Signals() as signals:
        for number in before:
            signal.raise_signal(number)
        signals.news()
        signals.shut()
        found = []
        for number in within:
            signal.raise_signal(number)
            found.append(signals.hurry())
        assert found == levels
        assert signals.hurry() == 0
