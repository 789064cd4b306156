"""A question while the picture of the jog is shown: it stands among the notices, y answers, q ends the run."""

import pytest

from pmabench.base.errors import Interrupted
from pmabench.cli.monitor import _AtKeys, _Keys
from pmabench.display.channel import Page


def asked(*pressed):
    """What stands on the page at each wait, and what came of it; one key is pressed during each wait."""
    page, keys, left, seen = Page("bench", notices=("before",)), _Keys(), list(pressed), []

    def wait():
        seen.append(tuple(page.notices))
        keys.append(left.pop(0))

    return _AtKeys(page, keys).ask("The driver was never tried on a device. " * 4, {}, wait), page, seen


def test_y_answers_and_other_keys_do_not():
    answer, page, seen = asked("x", "+", "y")
    assert (answer, page.notices, len(seen)) == ("y", ("before",), 3)
    assert " ".join(seen[0][:-1]) == ("The driver was never tried on a device. " * 4).strip()
    assert all(len(line) <= 76 for line in seen[0])
    assert seen[0][-1] == "y goes on, q ends"


@pytest.mark.parametrize("key", "qvQV")
def test_q_and_v_end_the_run(key):
    with pytest.raises(Interrupted, match="at the question"):
        asked("x", key)
