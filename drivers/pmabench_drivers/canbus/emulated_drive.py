"""Emulated CANopen devices: a CiA 402 drive that moves the free end of the plant, and a CiA 406 linear encoder.

Objects of the encoder, their types and access: device properties according to CiA DS 406 in the operation manual of the
Temposonics E-Series CANopen (table 17); position 6004h: CiA 406, class C2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pmabench.bench.interface import Scale
from pmabench_drivers.canbus import frames as f
from pmabench_drivers.canbus.emulated_node import LOST_HEARTBEAT, STATE, VALUE, Abort, EmulatedNode, Entry
from pmabench_drivers.canbus.frames import Frame, State
from pmabench_drivers.emulator.plant import RealPlant

LINEAR_ENCODER = 406 | 8 << 16
"""Device type: the profile, and an absolute linear encoder."""
STEP = 1000
"""Measuring step: 1 um, in units of 0.001 um."""
VELOCITY, STATUS = f.mapping(0x6030, 1, 16), f.mapping(0x6400, 1, 8)
"""What the encoder sends behind its position."""
WORDS = {state: value for _mask, value, state in f.STATES}
FOLLOWING_ERROR = 0x8611
SERVO_DRIVE = 402 | 2 << 16
"""Device type: the profile, and the kind of drive."""
CONNECTION_LOST = 0x8100
OPTION_STAYS = 5
"""Smallest quick stop option code with which a drive stays in quick stop active."""


def encoder_objects(node: EmulatedNode, position: Callable[[], int]) -> dict[tuple[int, int], Entry]:
    """Objects of the profile; `position` [steps] returns the present position of the magnet."""
    node.preset(f.DEVICE_TYPE, 0, LINEAR_ENCODER)
    objects = {
        (0x6004, 0): Entry("i", read=position),
        (0x6005, 1): Entry("I", STEP),
        (0x6020, 1): Entry("i", read=position),
        (0x6030, 1): Entry("h", 0),
        (0x6400, 1): Entry("B", 0),
        (0x6503, 0): Entry("H", 0),
    }
    counts = {index: max(sub for at, sub in objects if at == index) for index, _sub in objects}
    return objects | {(index, 0): Entry("B", count) for index, count in counts.items() if count}


class EmulatedDrive(EmulatedNode):
    """A drive with the counts of the bench's output `scale`; `note` is called with what it does."""

    def __init__(
        self,
        number: int,
        model: str,
        send: Callable[[Frame], None],
        plant: RealPlant,
        scale: Scale,
        stroke: Sequence[int],
        note: Callable[..., Any],
    ) -> None:
        super().__init__(number, 402, model, send)
        self._plant, self._scale, self._note = plant, scale, note
        self.drive_state = State.DISABLED
        self.obeys = True
        """Whether it advances from state to state, as with an active enable input."""
        self.preset(f.DEVICE_TYPE, 0, SERVO_DRIVE)
        self._word = 0
        self._acknowledged = self._limited = False
        self._late_since = 0.0
        self._last = 0.0
        """Last commanded position [m of contraction]."""
        self._target_at = 0.0
        """When it will have reached its target [s, monotonic]."""
        self.objects |= {
            (f.CONTROLWORD, 0): Entry("H", 0, writable=True, written=self._control),
            (f.STATUSWORD, 0): Entry("H", read=self._status),
            (f.MODE, 0): Entry("b", 0, writable=True, written=self._change_mode),
            (f.MODE_SHOWN, 0): Entry("b", 0),
            (f.TARGET, 0): Entry("i", self._actual(), writable=True),
            (f.ACTUAL, 0): Entry("i", read=self._actual),
            (f.DEMAND, 0): Entry("i", read=self._demand),
            (f.PROFILE_VELOCITY, 0): Entry("I", 1000, writable=True),
            (f.LIMITS, 0): Entry("B", 2),
            (f.LIMITS, 1): Entry("i", stroke[0], writable=True),
            (f.LIMITS, 2): Entry("i", stroke[1], writable=True),
            (f.SUPPORTED, 0): Entry("I", 1 << (f.PROFILE - 1) | 1 << (f.CYCLIC - 1)),
            (f.ABORT_OPTION, 0): Entry("h", 1, writable=True, written=self._option(0, 3)),
            (f.QUICK_STOP_OPTION, 0): Entry("h", 2, writable=True, written=self._option(0, 8)),
            (f.ERROR_CODE, 0): Entry("H", 0),
            (f.PERIOD, 0): Entry("B", 2),
            (f.PERIOD, 1): Entry("B", 10, writable=True),
            (f.PERIOD, 2): Entry("b", -3, writable=True),
            (f.WINDOW, 0): Entry("I", 0xFFFFFFFF, writable=True),
            (f.WINDOW_TIME, 0): Entry("H", 100, writable=True),
        }

    # -- position -----------------------------------------------------------------------------------------------------

    def _actual(self) -> int:
        return round(float(self._scale.to_raw(self._plant.at(self.now)["displacement"])))

    def _demand(self) -> int:
        return round(float(self._scale.to_raw(self._plant.at(self.now)["displacement_command"])))

    def _status(self) -> int:
        word = WORDS[self.drive_state] | 1 << 9
        if self.drive_state in {State.READY, State.ON, State.ENABLED, State.STOPPED}:
            word |= 1 << 4
        if self.now >= self._target_at:
            word |= f.TARGET_REACHED
        if self._limited:
            word |= f.INTERNAL_LIMIT
        if self._acknowledged:
            word |= f.ACKNOWLEDGE
        return word

    # -- state machine ------------------------------------------------------------------------------------------------

    def _control(self, word: int) -> None:
        before, self._word = self._word, word
        if word & ~before & 0x80 and self.drive_state is State.FAULT:
            self._reset_fault()
            return
        if self.drive_state is State.FAULT:
            return
        follows = _follows(self.drive_state, word, stays=self.get(f.QUICK_STOP_OPTION) >= OPTION_STAYS)
        going_on = follows in {State.READY, State.ON, State.ENABLED}
        if follows is not self.drive_state and (self.obeys or not going_on):
            self._enter(follows)
        if self.drive_state is State.ENABLED and self.get(f.MODE_SHOWN) == f.PROFILE:
            self._set_point(before, word)

    def _enter(self, state: State) -> None:
        before, self.drive_state = self.drive_state, state
        self._note("state", state=state.value)
        if before is State.ENABLED and state is not State.ENABLED:
            place = self._plant.stop_drive()
            self._target_at, self._acknowledged = self.now, False
            self._note("halt", si=place)
        if state is State.ENABLED:
            self._last = self._plant.quantities()["displacement_command"]

    def _reset_fault(self) -> None:
        if self._late_since:
            return
        self.objects[f.ERROR_CODE, 0].value = 0
        self._enter(State.DISABLED)
        self.emergency(0, f.COMMUNICATION_ERROR | 1 if self._missed else 0)

    def fault(self, code: int) -> None:
        """Stop with a fault, and send the emergency."""
        self.objects[f.ERROR_CODE, 0].value = code
        self._enter(State.FAULT)
        self.emergency(code, 0x21)

    def well(self) -> bool:
        """Whether it has no fault."""
        return self.drive_state is not State.FAULT

    def lost_heartbeat(self) -> None:
        """React as set in object 6007h."""
        self._note("watchdog", option=self.get(f.ABORT_OPTION))
        self._lost(LOST_HEARTBEAT)

    def stopped(self) -> None:
        """React as to a lost connection."""
        self._lost(CONNECTION_LOST)

    def _lost(self, code: int) -> None:
        """React as set in object 6007h; `code` is used if that is a fault."""
        if (option := self.get(f.ABORT_OPTION)) == 1:
            self.fault(code)
        elif option == 2:
            self._enter(State.DISABLED)
        elif option == f.QUICK_STOP_ON_LOSS and self.drive_state is State.ENABLED:
            stays = self.get(f.QUICK_STOP_OPTION) >= OPTION_STAYS
            self._enter(State.STOPPED if stays else State.DISABLED)

    def _option(self, low: int, high: int) -> Callable[[int], None]:
        def check(value: int) -> None:
            if not low <= value <= high:
                raise Abort(VALUE)

        return check

    # -- motion -------------------------------------------------------------------------------------------------------

    def _change_mode(self, mode: int) -> None:
        if mode not in f.MODES:
            raise Abort(VALUE)
        if mode != self.get(f.MODE_SHOWN) and self.drive_state is State.ENABLED and self.now < self._target_at:
            raise Abort(STATE)
        self.objects[f.MODE_SHOWN, 0].value = mode
        self._acknowledged = False

    def _inside(self, target: int) -> float:
        """The target within its software limits, as a position [m of contraction]."""
        low, high = self.get(f.LIMITS, 1), self.get(f.LIMITS, 2)
        held = min(max(target, low), high) if low < high else target
        self._limited = held != target
        return float(self._scale.to_si(held))

    def _set_point(self, before: int, word: int) -> None:
        """Profile position: a rising edge of `new set-point` takes the target."""
        if not word & f.NEW_SET_POINT:
            self._acknowledged = False
            return
        if before & f.NEW_SET_POINT:
            return
        place = self._inside(self.get(f.TARGET))
        speed = self.get(f.PROFILE_VELOCITY) * abs(self._scale.slope)
        start = self._plant.stop_drive() if self.now < self._target_at else self._last
        self._plant.drive(place, speed)
        self._target_at = self.now + abs(place - start) / speed if speed else float("inf")
        self._acknowledged, self._last = True, place
        self._note("move", raw=self.get(f.TARGET), si=place, speed=speed)

    def synchronised(self) -> None:
        """Cyclic synchronous position: be at the target one period from now."""
        if self.drive_state is not State.ENABLED or self.get(f.MODE_SHOWN) != f.CYCLIC:
            return
        if (place := self._inside(self.get(f.TARGET))) == self._last:
            return
        period = self.get(f.PERIOD, 1) * 10.0 ** self.get(f.PERIOD, 2)
        self._plant.drive(place, abs(place - self._last) / period)
        self._last = place
        self._note("move", raw=self.get(f.TARGET), si=place)

    def turn(self, now: float) -> None:
        """Act as every node, and monitor the following error."""
        super().turn(now)
        window = self.get(f.WINDOW)
        if window == 0xFFFFFFFF or self.drive_state is not State.ENABLED:
            self._late_since = 0.0
            return
        if abs(self._demand() - self._actual()) <= window:
            self._late_since = 0.0
        elif not self._late_since:
            self._late_since = now
        elif now - self._late_since > self.get(f.WINDOW_TIME) * 1e-3:
            self._late_since = 0.0
            self.fault(FOLLOWING_ERROR)

    def reset(self) -> None:
        """Restart without power, at rest at the present position."""
        if self.drive_state is not State.DISABLED:
            self._enter(State.DISABLED)
        self._word, self._limited, self._late_since = 0, False, 0.0
        super().reset()
        self.objects[f.TARGET, 0].value = self._actual()


def _follows(state: State, word: int, *, stays: bool) -> State:
    """Next state for a controlword (CiA 402-2, transitions 2 to 12 and 16)."""
    if not word & 0x02:
        return State.DISABLED
    if not word & 0x04:
        if state is State.ENABLED:
            return State.STOPPED if stays else State.DISABLED
        return state if state is State.STOPPED else State.DISABLED
    if state is State.STOPPED:
        return State.ENABLED if word & 0x0F == 0x0F and stays else state
    if not word & 0x01:
        return State.READY
    if state is State.DISABLED:
        return state
    if state is State.READY:
        return State.ON
    return State.ENABLED if word & 0x08 else State.ON
