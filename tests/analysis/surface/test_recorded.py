"""A fluidic muscle that another lab recorded, filled, held and emptied at lengths that were set by hand.

Each test is predicted from the two others at the same lengths, after one constant that is taken from its own filling:
what counts is the way back. Limits are those of a published prototype; the data are not part of the project.
"""

from pathlib import Path

import numpy as np
import pytest

from pmabench.analysis.surface.fit import Data, choose
from pmabench.analysis.surface.trials import by_hand
from pmabench.kinds.reduce import reduce_together
from pmabench.kinds.surface.reduction import records_of
from pmabench.store.reader import open_run
from tests.importing import import_files
from tests.recorded import recorded_data

MAP = Path(__file__).resolve().parents[3] / "fixtures/maps/aarl-10mm.yaml"
FULL = 363.0


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    files = sorted((recorded_data() / "aarl_10mm").glob("10mm_13cm_*.csv"))
    return [(file.stem, open_run(run.path)) for file, run in zip(
        files, import_files(files, MAP, tmp_path_factory.mktemp("runs")), strict=True)]  # fmt: skip


def branches(record):
    """Rows of the filling and of the emptying that count, above the pressures at which the muscle is slack."""
    above = record.used & (record.P > 180e3)
    at = np.arange(len(record.t))
    middle = record.t - record.t[0]
    level = np.median(record.P[(middle > 20) & (middle < 25)])
    top = int(np.argmax(record.P > 0.97 * record.P.max()))
    out = int(np.flatnonzero((middle > 20) & (record.P < 0.985 * level))[0])
    return above & (at < top), above & (at >= out)


def ways_back(runs, predict):
    """Rms error on the emptying of each test without it [N], equal steps of pressure counting alike."""
    found = []
    for left_out in ("Test1", "Test2", "Test10"):
        known, _ = records_of([run for name, run in runs if not name.endswith(left_out)], {"isometric": by_hand})
        others, _ = records_of([run for name, run in runs if name.endswith(left_out)], {"isometric": by_hand})
        predicted = predict(known)
        for record in others:
            fill, empty = branches(record)
            error = record.F - predicted(record)
            error -= error[fill].mean()
            way = np.abs(np.gradient(record.P))[empty]
            found.append(float(way @ error[empty] ** 2 / way.sum()))
    return float(np.sqrt(np.mean(found)))


def of_surface(known):
    muscle = choose(Data.of(known)).muscle
    return lambda record: muscle.force([record])


def of_lines(known):
    lines = {}
    for x in {round(float(r.x[0]), 6) for r in known}:
        mine = [r for r in known if round(float(r.x[0]), 6) == x]
        kept = [r.used & (r.P > 180e3) for r in mine]
        P, F = (np.concatenate([getattr(r, name)[k] for r, k in zip(mine, kept, strict=True)]) for name in ("P", "F"))
        way = np.concatenate([np.abs(np.gradient(r.P))[k] for r, k in zip(mine, kept, strict=True)])
        lines[x] = np.polyfit(P, F, 1, w=np.sqrt(way))
    return lambda record: np.polyval(lines[round(float(record.x[0]), 6)], record.P)


def test_the_way_back_of_a_test_that_was_left_out_is_predicted(runs):
    own, lines = ways_back(runs, of_surface) / FULL, ways_back(runs, of_lines) / FULL
    assert own <= 0.015
    assert 0.03 <= lines <= 0.038, "a straight line per contraction leaves 3.4 %"


def test_it_is_said_that_one_cycle_does_not_show_hysteresis_from_creep(runs):
    (analysis,) = reduce_together("surface", [run for _, run in runs])
    said = [finding.text for finding in analysis.findings if finding.level == "doubt"]
    assert any("one cycle at one speed does not tell hysteresis from creep" in text for text in said)
    secants = [e for e in analysis.estimates if e.symbol == "K_s" and e.value is not None]
    assert secants
    assert not any(e.symbol in ("B_c", "B_r", "H", "W") for e in analysis.estimates), "nothing moved"
