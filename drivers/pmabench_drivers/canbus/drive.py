"""One CiA 402 drive: enabling step by step, motions to positions, cyclic targets along a sine, stop.

Commands use SDO, so that each is answered; only the targets of a cyclic motion use PDO, one at each SYNC.
Positions and speeds are in counts of the drive.
"""

from __future__ import annotations

from time import monotonic, sleep

from pmabench.base.errors import DeviceError, NotSent
from pmabench_drivers.canbus import frames as f
from pmabench_drivers.canbus.node import Node, Refused, Send

POLL = 0.002
"""Interval for reading the statusword [s]."""
STEP = 0.12
"""Time limit for a step of the state machine [s]."""
FRESH = 0.1
"""How long a statusword from a PDO is valid [s]."""
I32 = 2**31


class Drive(Node):
    """A drive of the bus; `position`, `demand` and `status` are the newest values from its PDOs."""

    profile = 402

    def __init__(self, device: str, name: str, number: int, send: Send) -> None:
        super().__init__(device, name, number, send)
        self.position = self.demand = self.status = 0
        self.wants_demand = False
        """Whether a channel records its demand position."""
        self.period = 0.01
        """Time between two SYNCs [s]."""
        self._target_pdo = 0
        self._updated = 0.0
        """When a PDO last brought its statusword [s, monotonic]."""
        self._may_reset = True
        self._expected = False
        """Whether it should be in operation: leaving it is then a failure."""
        self._cyclic = False

    # -- setting up ---------------------------------------------------------------------------------------------------

    def set_up(self, deadline: float) -> None:
        """Set up PDOs; modes profile position and cyclic synchronous position are required."""
        modes = self.objects.read_if_there(f.SUPPORTED, 0, "I", deadline)
        for mode, name in f.MODES.items():
            if modes is not None and not f.supports(modes, mode):
                raise self.error(f"has no mode {name} (object 6502h is {modes:08X}h)")
        self._expected = self._cyclic = False
        self._may_reset = True
        self.mapped.clear()
        status, actual = f.mapping(f.STATUSWORD, 0, 16), f.mapping(f.ACTUAL, 0, 32)
        self.transmit(0, [status, actual], self._take_actual, deadline)
        if self.wants_demand:
            self.transmit(1, [f.mapping(f.DEMAND, 0, 32)], self._take_demand, deadline)
        self._target_pdo = self.receive(0, [f.mapping(f.TARGET, 0, 32)], deadline)
        self.relied = {"position mapping": (f.TPDO_MAPPING, 2), "target mapping": (f.RPDO_MAPPING, 1)}
        self._set_period(deadline)

    def _set_period(self, deadline: float) -> None:
        """Set the time between two SYNCs, over which it interpolates."""
        units, exponent = round(self.period * 1e3), -3
        if abs(units * 1e-3 - self.period) > 1e-9:
            units, exponent = round(self.period * 1e4), -4
        self.objects.set(f.PERIOD, 2, "b", exponent, deadline)
        self.objects.set(f.PERIOD, 1, "B", units, deadline)

    def limits(self, deadline: float) -> tuple[int, int] | None:
        """Its software position limits [count]; None without any."""
        low = self.objects.read_if_there(f.LIMITS, 1, "i", deadline)
        high = self.objects.read_if_there(f.LIMITS, 2, "i", deadline)
        return None if low is None or high is None or low >= high else (low, high)

    def _take_actual(self, data: bytes) -> bool:
        if len(data) != 6:
            return False
        self.status = int.from_bytes(data[:2], "little")
        self.position, self._updated = int.from_bytes(data[2:], "little", signed=True), monotonic()
        state = f.state_of(self.status)
        if self._expected and state in {f.State.FAULT, f.State.REACTING, f.State.DISABLED, f.State.STOPPED}:
            self._expected = False
            self._trouble = self._trouble or f"{self.name}: has stopped by itself: it is in {state.value}"
        return True

    def _take_demand(self, data: bytes) -> bool:
        if len(data) != 4:
            return False
        self.demand = int.from_bytes(data, "little", signed=True)
        return True

    # -- its state machine --------------------------------------------------------------------------------------------

    def state(self, deadline: float) -> f.State:
        """State reported by the drive."""
        self.status = self.objects.read(f.STATUSWORD, 0, "H", deadline)
        if (state := f.state_of(self.status)) is None:
            raise self.error(f"says the statusword {self.status:04X}h, which is no state of CiA 402")
        return state

    def ready(self, deadline: float) -> bool:
        """Whether it has no fault; asks it unless a PDO was just received. Raises DeviceError with a known error."""
        if trouble := self.trouble():
            raise DeviceError(self.device, trouble, self.name)
        recent = monotonic() - self._updated < FRESH
        state = f.state_of(self.status) if recent else self.state(deadline)
        return state not in {f.State.FAULT, f.State.REACTING, f.State.NOT_READY, None}

    def prepare(self, deadline: float) -> None:
        """Advance to switched on, without operation; an earlier fault is acknowledged once."""
        self._advance(f.State.ON, deadline)

    def enable(self, deadline: float) -> None:
        """Enable operation; DeviceError states where it stays and the possible reason."""
        self._advance(f.State.ENABLED, deadline)
        self._may_reset = False

    def _advance(self, goal: f.State, deadline: float) -> None:
        state = self.state(deadline)
        while state is not goal and state is not f.State.ENABLED:
            if goal is f.State.ON and state is f.State.STOPPED:
                return
            if state in {f.State.FAULT, f.State.REACTING}:
                state = self._reset(deadline)
                continue
            if state not in f.NEXT:
                raise self._stuck(state, goal)
            if state is f.State.STOPPED or f.NEXT[state][1] is f.State.ENABLED:
                # the present position becomes the target, so that nothing moves when operation is enabled
                actual = self.objects.read(f.ACTUAL, 0, "i", deadline)
                self.objects.write(f.TARGET, 0, "i", actual, deadline)
            word, follows = f.NEXT[state]
            self._control(word, deadline)
            before, state = state, self._reach({follows, f.State.ENABLED}, deadline)
            if state is before:
                raise self._stuck(state, goal)

    def _reach(self, goals: set[f.State], deadline: float) -> f.State:
        """Wait for one of the states, a fault, or the time limit; returns the state then."""
        until = min(deadline, monotonic() + STEP)
        while True:
            state = self.state(deadline)
            if state in goals or state is f.State.FAULT or monotonic() + POLL >= until:
                return state
            sleep(POLL)

    def _reset(self, deadline: float) -> f.State:
        code = self.objects.read(f.ERROR_CODE, 0, "H", deadline)
        message = f"is in fault, error code {code:04X}h: {f.emergency_text(code)}"
        if not self._may_reset:
            raise self.error(f"{message}; the next run acknowledges it")
        self._may_reset = False
        self._control(0, deadline)
        self._control(f.FAULT_RESET, deadline)
        state = self._reach({f.State.DISABLED}, deadline)
        self._control(0, deadline)
        if state is not f.State.DISABLED:
            raise self.error(f"{message}; it cannot be acknowledged, so its cause is still there")
        return state

    def _stuck(self, state: f.State, goal: f.State) -> DeviceError:
        why = f.why_not(state, self.status)
        return self.error(f"stays in {state.value} and does not go on to {goal.value}: {why}")

    def _control(self, word: int, deadline: float) -> None:
        self.objects.write(f.CONTROLWORD, 0, "H", word, deadline)

    def _use(self, mode: int, deadline: float) -> None:
        """Change the mode of operation, unless it is set already."""
        if self.objects.read(f.MODE_SHOWN, 0, "b", deadline) == mode:
            return
        self.objects.write(f.MODE, 0, "b", mode, deadline)
        until = min(deadline, monotonic() + STEP)
        while self.objects.read(f.MODE_SHOWN, 0, "b", deadline) != mode:
            if monotonic() + POLL >= until:
                raise self.error(f"does not change to the mode {f.MODES[mode]}")
            sleep(POLL)

    # -- motion -------------------------------------------------------------------------------------------------------

    def go(self, target: int, speed: int, deadline: float) -> None:
        """Go to `target` at `speed` by itself, replacing a motion in progress."""
        self._check(target)
        self._cyclic = False
        self._use(f.PROFILE, deadline)
        self.enable(deadline)
        self.objects.write(f.PROFILE_VELOCITY, 0, "I", max(1, speed), deadline)
        self.objects.write(f.TARGET, 0, "i", target, deadline)
        self._control(f.ENABLE, deadline)
        self._control(f.ENABLE | f.NEW_SET_POINT | f.AT_ONCE, deadline)
        until = min(deadline, monotonic() + STEP)
        while not self.objects.read(f.STATUSWORD, 0, "H", deadline) & f.ACKNOWLEDGE:
            if monotonic() + POLL >= until:
                raise self.error(f"does not acknowledge the target {target}: it may not have its zero yet (homing)")
            sleep(POLL)
        self._control(f.ENABLE, deadline)
        if (held := self.objects.read(f.TARGET, 0, "i", deadline)) != target:
            raise self.error(f"holds the target {held} after {target} was sent")
        self._expected = True

    def begin_cyclic(self, origin: int, room: int, deadline: float) -> None:
        """Accept targets at each SYNC from now on; refused if it is further than `room` from `origin`."""
        self._check(origin)
        actual = self.objects.read(f.ACTUAL, 0, "i", deadline)
        if abs(actual - origin) > room:
            message = f"is at {actual} counts and cannot jump to {origin}, where the motion begins"
            raise NotSent(self.device, f"{message} (at most {room})", self.name)
        if self.state(deadline) is f.State.ENABLED and not self.status & f.TARGET_REACHED and not self._cyclic:
            message = "is still on its way to its last target: a cyclic motion begins at rest"
            raise NotSent(self.device, message, self.name)
        self.objects.write(f.TARGET, 0, "i", actual, deadline)
        self.lead = float(actual)
        self._use(f.CYCLIC, deadline)
        self.enable(deadline)
        self._expected = self._cyclic = True

    def lead_to(self, target: float, most: float) -> None:
        """Send the target of the next SYNC, at most `most` counts from the previous one."""
        if not self._cyclic:
            return
        self.lead = min(max(target, self.lead - most), self.lead + most)
        self._send(self._target_pdo, round(self.lead).to_bytes(4, "little", signed=True))

    def halt(self, deadline: float) -> None:
        """Quick stop, and hold at rest. Without power there is nothing to stop."""
        self._cyclic = self._expected = False
        self._control(f.QUICK_STOP, deadline)
        state = self._reach({f.State.STOPPED, f.State.DISABLED}, deadline)
        if state in {f.State.ENABLED, f.State.ON, f.State.READY}:
            raise self.error(f"was commanded to stop and is still in {state.value}")

    def target(self, deadline: float) -> int:
        """Target that it holds."""
        return self.objects.read(f.TARGET, 0, "i", deadline)

    def _check(self, target: int) -> None:
        if not -I32 <= target < I32:
            raise self.error(f"cannot be sent to {target}: positions are 32-bit numbers")

    # -- monitoring of the heartbeat ----------------------------------------------------------------------------------

    def arm(self, producer: int, seconds: float, deadline: float) -> float:
        """Make it stop by itself without the heartbeat of node `producer`; returns the time-out that it holds [s]."""
        try:
            self.objects.set(f.QUICK_STOP_OPTION, 0, "h", f.STAY_STOPPED, deadline)
            self.objects.set(f.ABORT_OPTION, 0, "h", f.QUICK_STOP_ON_LOSS, deadline)
        except Refused as error:
            message = f"{error.message}; without it the drive would not stop and hold when the program is gone"
            raise DeviceError(self.device, message, self.name) from None
        wanted = producer << 16 | min(int(seconds * 1e3 + 1e-6), 0xFFFF)
        self.objects.set(f.CONSUMER, 1, "I", 0, deadline)  # clears the setting of an earlier run
        self.objects.set(f.CONSUMER, 1, "I", wanted, deadline)
        return (wanted & 0xFFFF) * 1e-3

    def disarm(self, deadline: float) -> None:
        """Stop monitoring of a heartbeat; it stays in its state."""
        self.objects.set(f.CONSUMER, 1, "I", 0, deadline)

    def waits_for(self, producer: int, deadline: float) -> float:
        """Time until it stops without the heartbeat of node `producer` [s]; 0: never, or the heartbeat was missed.

        Whether it was missed is taken from the error register that `held` has just read.
        """
        held = self.objects.read(f.CONSUMER, 1, "I", deadline)
        missed = self.errors & f.COMMUNICATION_ERROR
        return 0.0 if held >> 16 & 0x7F != producer or missed else (held & 0xFFFF) * 1e-3
