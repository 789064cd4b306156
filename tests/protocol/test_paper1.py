"""Paper 1's procedure as a plan: 22 records with start and end pressure, the muscle's own weight as load (rows 17, 18)."""

from __future__ import annotations

from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.engine.resume import remaining
from pmabench.kinds.compile import make_plan
from pmabench.protocol.plan import Ask, Plan, Record, Set

ROOT = Path(__file__).resolve().parents[2]
SPECIMENS = ROOT / "fixtures" / "specimens"
STEPS = [1e5 + 0.5e5 * i for i in range(11)]


def plan(*settings: tuple[str, str], bench: str = "mock-dmsp-ideal", specimen: Path | None = None) -> Plan:
    specimen = specimen or SPECIMENS / "dmsp-40-305.yaml"
    mounted = mount(ROOT / "fixtures" / "benches" / f"{bench}.yaml", specimen)
    return make_plan(ROOT / "protocols" / "contraction-relaxation-paper1.yaml", mounted, settings)[0]


def commands(steps: object) -> list[tuple[str, float]]:
    return [(step.phase, step.value) for step in steps if isinstance(step, Set) and step.phase != "precondition"]


def test_22_records_are_tagged_with_start_and_end_pressure():
    points = [(trial.point["from"], trial.point["pressure"]) for trial in plan().trials]
    assert points == [pair for P in STEPS for pair in ((0.0, pytest.approx(P)), (pytest.approx(P), 0.0))]


def test_each_record_holds_one_step_from_its_start_to_its_end():
    compiled = plan()
    inside: dict[int, list[float]] = {}
    trial, pressure = None, 0.0
    for step in compiled.steps:
        if isinstance(step, Record):
            trial = step.trial if step.on else None
            if step.on:
                inside[step.trial] = [pressure]
        elif isinstance(step, Set):
            pressure = step.value
            if trial is not None:
                inside[trial].append(pressure)
    assert len(inside) == 22
    for record in compiled.trials:
        assert inside[record.index] == [record.point["from"], record.point["pressure"]]


def test_the_load_is_half_of_the_muscles_weight_and_no_hand_hangs_it_on():
    compiled = plan()
    assert [trial.point["load"] for trial in compiled.trials] == pytest.approx([0.5 * 1.0194 * 9.81] * 22)
    asked = [step for step in compiled.steps if isinstance(step, Ask)]
    assert [step.text for step in asked] == ["Take every weight off the free end."]
    assert asked[0].load[0] == pytest.approx(5.0, abs=1e-3)
    more = plan(("sweep.matrix.load", "[0.5 kg]"), bench="mock-dmsp")
    assert more.trials[0].point["load"] == pytest.approx((0.5 + 0.5 * 1.0194) * 9.81)
    assert next(step for step in more.steps if isinstance(step, Ask)).text.endswith("4.91 N.")


def test_a_hanging_muscle_carries_its_weight_in_the_classic_test_too():
    mounted = mount(ROOT / "fixtures" / "benches" / "mock-dmsp.yaml", SPECIMENS / "dmsp-40-305.yaml")
    settings = [("sweep.matrix.load", "[0.1 kg]"), ("layout", "vertical")]
    classic = make_plan(ROOT / "protocols" / "contraction-relaxation.yaml", mounted, settings)[0]
    assert classic.trials[0].point["load"] == pytest.approx((0.1 + 0.5 * 1.0194) * 9.81)


@pytest.mark.parametrize("done", [{0}, {1}, {0, 1, 2}, set(range(22)) - {1}, set(range(22)) - {20}])
def test_what_is_left_after_a_cut_begins_where_its_record_says(done: set[int]):
    """A relaxation that is resumed alone is pressurised first, a contraction is released first."""
    compiled = plan()
    pressure = 0.0
    seen = []
    for step in remaining(compiled, done):
        if isinstance(step, Set):
            pressure = step.value
        elif isinstance(step, Record) and step.on:
            assert pressure == compiled.trials[step.trial].point["from"]
            seen.append(step.trial)
    assert seen == [index for index in range(22) if index not in done]


def test_below_1_bar_is_refused_with_the_reason():
    with pytest.raises(InvalidFile, match="50 kPa is below 100 kPa: .* damping would come out negative"):
        plan(("sweep.matrix.pressure", "[0.5 bar, 1 bar]"))


def test_all_that_does_not_fit_is_reported_at_once():
    with pytest.raises(InvalidFile) as caught:
        plan(
            ("sweep.matrix.pressure", "[0.9 bar]"), ("trial.relax.by", "50 kPa"), ("trial.relax.then", "10 kPa"),
            ("reference_trial", "{load: 0 kg, pressure: 1 bar, every: 2}"),
            ("accept", "{F_ce: {relative_interval: 5 %}}"),
            specimen=SPECIMENS / "mas-20-250-paper0.yaml",
        )  # fmt: skip
    reported = str(caught.value)
    for words in ("below 100 kPa", '"by"', "relaxes to 0 kPa", "cannot be combined", "takes F_ce as known", '"mass"'):
        assert words in reported, words
    assert '"braid_angle"' in reported


def test_without_the_reduction_steps_of_relaxation_are_needed():
    with pytest.raises(InvalidFile, match='"by" is missing'):
        plan(("reduction", "null"))


def test_a_braid_that_does_not_contract_is_refused(tmp_path: Path):
    text = (SPECIMENS / "dmsp-40-305.yaml").read_text(encoding="utf-8").replace("26.5 deg", "55 deg")
    (tmp_path / "wide.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidFile, match="54.74 deg or more"):
        plan(specimen=tmp_path / "wide.yaml")
