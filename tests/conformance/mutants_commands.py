"""Faults of set-points, valves, inputs, ramps and stops."""

import time
from contextlib import suppress
from dataclasses import replace

from pmabench.base.errors import DeviceError
from tests.conformance.faults import fault

# -- set-points -------------------------------------------------------------------------------------------------------


class _Factor:
    """Set-points in another unit, read back with the same mistake."""

    factor = 0.1

    def write(self, output, value):
        super().write(output, value * self.factor)

    def read_back(self, output):
        return super().read_back(output) / self.factor


@fault("SetPoint", "set-points", "unit")
class SetPointTenth(_Factor):
    pass


@fault("SetPoint", "set-points", "unit")
class SetPointHundredth(_Factor):
    factor = 0.01


@fault("SetPoint", "set-points", "")
class SetPointTimesHundred(_Factor):
    factor = 100.0


@fault("SetPoint", "set-points", "unit")
class SetPointThreePercentLow(_Factor):
    factor = 0.97


@fault("SetPoint", "set-points", "")
class SetPointNegated(_Factor):
    factor = -1.0


class _Output:
    """What faults of outputs have in common."""

    def _of(self, output):
        return next(o for o in self._device.outputs if o.output == output)

    def _span(self, output):
        record = self._of(output)
        return (record.high - record.low) / record.scale.slope


@fault("SetPoint", "set-points", "unit")
class SetPointOffset(_Output):
    """By a hundredth of the range, read back with the same mistake."""

    def write(self, output, value):
        super().write(output, value + 0.01 * self._span(output))

    def read_back(self, output):
        return super().read_back(output) - 0.01 * self._span(output)


@fault("SetPoint", "set-points", "unit")
class SetPointLimited(_Output):
    """To half of the range, and what was wanted is read back."""

    wanted = 0.0

    def write(self, output, value):
        self.wanted = value
        half = self._of(output).scale.to_raw(self._of(output).safe) + 0.3 * self._span(output)
        super().write(output, min(value, half))

    def read_back(self, output):
        super().read_back(output)
        return self.wanted


@fault("SetPoint", "set-points", "unit")
class SetPointCoarse(_Output):
    """In steps of a tenth of the range."""

    wanted = 0.0

    def write(self, output, value):
        self.wanted, step = value, 0.1 * self._span(output)
        super().write(output, step * int(value / step))

    def read_back(self, output):
        super().read_back(output)
        return self.wanted


@fault("SetPoint", "set-points", "did nothing leave")
class SetPointNeverLeaves:
    """It is remembered, and nothing is sent."""

    wanted = 0.0

    def write(self, output, value):
        self.read_back(output)
        self.wanted = value

    def read_back(self, output):
        super().read_back(output)
        return self.wanted


@fault("SetPoint", "set-points", "did nothing leave")
class SetPointLeavesWithTheNextCall:
    waiting = None

    def write(self, output, value):
        super().read_back(output)
        self.waiting = output, value

    def read_back(self, output):
        if self.waiting is not None:
            super().write(*self.waiting)
            self.waiting = None
        return super().read_back(output)


@fault("SetPoint", "set-points", "", least=2)
class SetPointsSwapped:
    """Where there are two outputs."""

    def _other(self, output):
        names = [o.output for o in self._device.outputs]
        return names[1 - names.index(output)] if output in names else output

    def write(self, output, value):
        super().write(self._other(output), value)

    def read_back(self, output):
        return super().read_back(self._other(output))


@fault("SetPoint", "set-points", "returned")
class WriteReturnsTheValue:
    def write(self, output, value):
        super().write(output, value)
        return value


@fault("SetPoint", "set-points", "read back")
class ReadBackIsText:
    def read_back(self, output):
        return str(super().read_back(output))


@fault("SetPoint", "set-points", "KeyError")
class ReadBackRaisesRaw:
    def read_back(self, output):
        raise KeyError(output)


@fault("SetPoint", "set-points", "DeviceError is expected")
class AnyOutputWillDo:
    """A name that is not known is taken for the first output."""

    def _one(self, output):
        names = [o.output for o in self._device.outputs]
        return output if output in names else names[0]

    def write(self, output, value):
        super().write(self._one(output), value)

    def read_back(self, output):
        return super().read_back(self._one(output))


@fault("SetPoint", "silence", "as if all were well")
class WriteSwallowsErrors:
    def write(self, output, value):
        with suppress(DeviceError):
            super().write(output, value)


@fault("SetPoint", "from outside", "memory")
class ReadBackFromMemory:
    """It asks, and gives what it wrote last."""

    wanted = None

    def write(self, output, value):
        super().write(output, value)
        self.wanted = {**(self.wanted or {}), output: value}

    def read_back(self, output):
        asked = super().read_back(output)
        return (self.wanted or {}).get(output, asked)


@fault("SetPoint", "from outside", "memory")
class ReadBackKeptToTheNextCommand:
    """It asks once after each command, and gives that answer from then on."""

    kept = None

    def write(self, output, value):
        super().write(output, value)
        self.kept = {}

    def read_back(self, output):
        if self.kept is None:
            return super().read_back(output)
        if output not in self.kept:
            self.kept[output] = super().read_back(output)
        return self.kept[output]


@fault("SetPoint", "silence", "as if all were well")
class ReadBackFromMemoryInSilence:
    """It gives what it read last where nothing answers."""

    seen = 0.0

    def read_back(self, output):
        try:
            self.seen = super().read_back(output)
        except DeviceError as error:
            if "not open" in str(error):
                raise
        return self.seen


@fault("SetPoint", "late answers", "")
class ReadBackOneAnswerOld:
    """The answer to the question before is given."""

    seen = None

    def read_back(self, output):
        now = super().read_back(output)
        before, self.seen = self.seen, now
        return now if before is None else before


# -- valves -----------------------------------------------------------------------------------------------------------


@fault("Switch", "valves", "inverted")
class ValveInverted:
    """Written and read the wrong way round."""

    def switch(self, output, *, on):
        super().switch(output, on=not on)

    def is_on(self, output):
        return not super().is_on(output)


@fault("Switch", "valves", "is_on() gives")
class IsOnNegated:
    def is_on(self, output):
        return not super().is_on(output)


@fault("Switch", "valves", "another one", least=2)
class ValvesSwapped:
    def _other(self, output):
        names = [v.output for v in self._device.valves]
        return names[1 - names.index(output)] if output in names else output

    def switch(self, output, *, on):
        super().switch(self._other(output), on=on)

    def is_on(self, output):
        return super().is_on(self._other(output))


@fault("Switch", "valves", "after switch(on=False)")
class ValveNeverOff:
    """It remembers that it was switched off."""

    wanted = False

    def switch(self, output, *, on):
        self.wanted = on
        super().switch(output, on=True)

    def is_on(self, output):
        super().is_on(output)
        return self.wanted


@fault("Switch", "valves", "")
class ValveLeavesWithTheNextCall:
    waiting = None

    def switch(self, output, *, on):
        super().is_on(output)
        self.waiting = output, on

    def is_on(self, output):
        if self.waiting is not None:
            super().switch(self.waiting[0], on=self.waiting[1])
            self.waiting = None
        return super().is_on(output)


@fault("Switch", "from outside", "memory")
class IsOnFromMemory:
    wanted = None

    def switch(self, output, *, on):
        super().switch(output, on=on)
        self.wanted = {**(self.wanted or {}), output: on}

    def is_on(self, output):
        asked = super().is_on(output)
        return (self.wanted or {}).get(output, asked)


@fault("Switch", "from outside", "memory")
class IsOnKeptToTheNextCommand:
    """It asks once after each command, and gives that answer from then on."""

    kept = None

    def switch(self, output, *, on):
        super().switch(output, on=on)
        self.kept = {}

    def is_on(self, output):
        if self.kept is None:
            return super().is_on(output)
        if output not in self.kept:
            self.kept[output] = super().is_on(output)
        return self.kept[output]


@fault("Switch", "valves", "is_on() gives 1")
class IsOnIsANumber:
    def is_on(self, output):
        return int(super().is_on(output))


@fault("Switch", "silence", "as if all were well")
class SwitchSwallowsErrors:
    def switch(self, output, *, on):
        with suppress(DeviceError):
            super().switch(output, on=on)


@fault("Switch", "valves", "DeviceError is expected")
class AnyValveWillDo:
    def switch(self, output, *, on):
        names = [v.output for v in self._device.valves]
        super().switch(output if output in names else names[0], on=on)


@fault("Switch", "set-points", "switched a valve")
class WriteSwitchesTheValveToo:
    def write(self, output, value):
        super().write(output, value)
        super().switch(self._device.valves[0].output, on=value > 0)


# -- inputs -----------------------------------------------------------------------------------------------------------


@fault("Inputs", "inputs", "contact is")
class LevelNegated:
    def level(self, name):
        return not super().level(name)


class _Locks:
    def _can_be_pressed(self):
        return any("stop" in lock.name for lock in self._device.interlocks)


@fault("Inputs", "inputs", "contact is unsafe")
class LevelFixed(_Locks):
    """Always as the bench calls it safe."""

    def level(self, name):
        super().level(name)
        return next(lock.safe for lock in self._device.interlocks if lock.input == name) == "high"


@fault("Inputs", "inputs", "contact is unsafe")
class LevelFromMemory(_Locks):
    seen = None

    def level(self, name):
        now = super().level(name)
        self.seen = now if self.seen is None else self.seen
        return self.seen


@fault("Inputs", "inputs", "True or False")
class LevelIsANumber:
    def level(self, name):
        return float(super().level(name))


@fault("Inputs", "inputs", "contact is unsafe")
class LevelOld(_Locks):
    """As it was 0.3 s ago, by the questions until then."""

    known = None

    def level(self, name):
        known = self.known = self.known or []
        known.append((time.monotonic(), name, super().level(name)))
        old = [level for at, asked, level in known if asked == name and at < known[-1][0] - 0.3]
        return (old or [known[-1][2]])[-1]


@fault("Inputs", "inputs", "contact is unsafe")
class LevelOfTheLastFeed(_Locks):
    """Asked when the watchdog is fed, which happens ten times a second."""

    known = None

    def feed_watchdog(self):
        super().feed_watchdog()
        self.known = {lock.input: super(LevelOfTheLastFeed, self).level(lock.input) for lock in self._device.interlocks}

    def level(self, name):
        now = super().level(name)
        return (self.known or {}).get(name, now)


# -- ramps, sines, stops ----------------------------------------------------------------------------------------------


@fault("Follower", "ramps", "ramp")
class RampEndsEarly:
    """At four fifths of its way."""

    def follow(self, output, segment):
        if segment.kind == "ramp":
            segment = replace(segment, target=segment.origin + 0.8 * (segment.target - segment.origin))
        super().follow(output, segment)


@fault("Follower", "ramps", "ramp")
class RampIsAStep:
    def follow(self, output, segment):
        if segment.kind == "ramp":
            super().write(output, segment.target)
        else:
            super().follow(output, segment)


@fault("Follower", "ramps", "ramp")
class RampAtHalfTheRate:
    def follow(self, output, segment):
        super().follow(output, replace(segment, rate=segment.rate / 2))


@fault("Follower", "ramps", "ramp")
class FollowDoesNothing:
    def follow(self, output, segment):
        super().read_back(output)


@fault("Follower", "ramps", "sine")
class SineHalf:
    def follow(self, output, segment):
        super().follow(output, replace(segment, amplitude=segment.amplitude / 2))


@fault("Follower", "ramps", "sine")
class SineNegated:
    def follow(self, output, segment):
        super().follow(output, replace(segment, amplitude=-segment.amplitude))


@fault("Follower", "ramps", "sine")
class SineTwice:
    """A cycle too many."""

    def follow(self, output, segment):
        super().follow(output, replace(segment, cycles=2 * segment.cycles))


@fault("Follower", "ramps", "still follows")
class WriteDoesNotEndARamp:
    segment = None

    def follow(self, output, segment):
        self.segment = segment
        super().follow(output, segment)

    def write(self, output, value):
        super().write(output, value)
        if self.segment is not None and self.segment.kind == "ramp":
            super().follow(output, self.segment)


@fault("Motion", "halt", "still moves")
class HaltDoesNothing:
    def halt(self, output):
        super().read_back(output)


@fault("Motion", "halt", "")
class HaltGoesToTheSafeValue:
    def halt(self, output):
        record = next(o for o in self._device.outputs if o.output == output)
        super().halt(output)
        super().write(output, record.scale.to_raw(record.safe))
