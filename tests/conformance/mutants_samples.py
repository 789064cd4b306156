"""Faults of samples: their values, their times, their blocks."""

import time
from dataclasses import replace

from pmabench.bench.interface import Block
from tests.conformance.faults import fault


def changed(block, change):
    """A block with other columns: `change(name, values)`."""
    return Block(block.time, {name: list(change(name, list(v))) for name, v in block.columns.items()}, block.host)


class _Channels:
    """What faults of samples have in common."""

    def _channel(self, name):
        return next(channel for channel in self._device.channels if channel.name == name)

    def _in_counts(self, name, value):
        return float(round(value)) if self._channel(name).raw_type == "int32" else value

    def _raw(self, name, si):
        return self._in_counts(name, self._channel(name).scale.to_raw(si))


# -- values -----------------------------------------------------------------------------------------------------------


@fault("Stream", "values", "where the emulated plant has")
class ValuesTimesHundred(_Channels):
    def collect(self):
        return changed(super().collect(), lambda n, v: [100 * x for x in v])


@fault("Stream", "values", "where the emulated plant has")
class ValuesHundredth(_Channels):
    """Bar is taken for kilopascal."""

    def collect(self):
        return changed(super().collect(), lambda n, v: [self._in_counts(n, x / 100) for x in v])


@fault("Stream", "values", "where the emulated plant has")
class ValuesAreSi(_Channels):
    """It scales by itself, and the bench once more."""

    def collect(self):
        return changed(super().collect(), lambda n, v: [self._in_counts(n, self._channel(n).scale.to_si(x)) for x in v])


@fault("Stream", "values")
class ValuesNegated(_Channels):
    def collect(self):
        return changed(super().collect(), lambda n, v: [-x for x in v])


@fault("Stream", "values", "where the emulated plant has")
class ValuesOffset(_Channels):
    """By one part in a hundred of the range."""

    def collect(self):
        def off(name, values):
            channel = self._channel(name)
            step = (channel.high - channel.low) / 100 / channel.scale.slope
            return [self._in_counts(name, x + step) for x in values]

        return changed(super().collect(), off)


@fault("Stream", "values", "where the emulated plant has")
class ValuesFivePercentHigh(_Channels):
    def collect(self):
        def high(name, values):
            scale = self._channel(name).scale
            return [self._raw(name, 1.05 * scale.to_si(x)) for x in values]

        return changed(super().collect(), high)


@fault("Stream", "values", "where the emulated plant has", least=2)
class ValuesSwapped(_Channels):
    """Each column is its neighbour's."""

    def collect(self):
        block = super().collect()
        names = list(block.columns)
        columns = {name: list(block.columns[other]) for name, other in zip(names, [*names[1:], names[0]], strict=True)}
        return Block(block.time, {n: [self._in_counts(n, x) for x in v] for n, v in columns.items()}, block.host)


@fault("Stream", "values", "where the emulated plant has")
class ValuesFrozen(_Channels):
    first = None

    def collect(self):
        def frozen(name, values):
            self.first = self.first or {}
            if values:
                self.first.setdefault(name, values[0])
            return [self.first.get(name, 0.0)] * len(values)

        return changed(super().collect(), frozen)


@fault("Stream", "values", "")
class ValuesClipped(_Channels):
    """At a quarter of the range."""

    def collect(self):
        def clipped(name, values):
            channel = self._channel(name)
            most = channel.low + 0.25 * (channel.high - channel.low)
            return [self._raw(name, min(channel.scale.to_si(x), most)) for x in values]

        return changed(super().collect(), clipped)


@fault("Stream", "values", "")
class ValuesCoarse(_Channels):
    """In steps of two parts in a hundred of the range."""

    def collect(self):
        def coarse(name, values):
            channel = self._channel(name)
            step = 0.02 * (channel.high - channel.low)
            return [self._raw(name, step * round(channel.scale.to_si(x) / step)) for x in values]

        return changed(super().collect(), coarse)


@fault("Stream", "values", "")
class ValuesNeverNegativeAndNeverSmall(_Channels):
    """Small values are shown as zero."""

    def collect(self):
        def dead(name, values):
            channel = self._channel(name)
            return [0.0 if abs(channel.scale.to_si(x)) < 0.3 * channel.high else x for x in values]

        return changed(super().collect(), dead)


@fault("Stream", "values", "NaN")
class ValuesNaN(_Channels):
    """A sample of ten is no number."""

    n = 0

    def collect(self):
        def holed(_name, values):
            self.n += 1
            return [float("nan") if i % 10 == 0 else x for i, x in enumerate(values)]

        return changed(super().collect(), holed)


# -- values and their times -------------------------------------------------------------------------------------------


class _Shifted(_Channels):
    """Values that belong to other times: the last `behind` values are kept back."""

    behind = 1
    kept = None

    def collect(self):
        def late(name, values):
            kept = (self.kept or {}).get(name, [])
            both = kept + values
            given = both[: len(values)] if len(kept) >= self.behind else values
            self.kept = {**(self.kept or {}), name: both[-self.behind :]}
            return given

        return changed(super().collect(), late)


@fault("Stream", "values", "too old")
class ValuesOneSampleLate(_Shifted):
    """The answer before is taken for the newest."""


@fault("Stream", "values", "too old")
class ValuesThreeSamplesLate(_Shifted):
    behind = 3


@fault("Stream", "values", "samples of")
class ValuesRepeatedInTurn(_Channels):
    """Each sample three times."""

    def collect(self):
        return changed(super().collect(), lambda n, v: [v[i - i % 3] for i in range(len(v))])


@fault("Stream", "values", "")
class ValuesOfTheBlocksEnd(_Channels):
    """All samples of a block have its last value."""

    def collect(self):
        return changed(super().collect(), lambda n, v: [v[-1]] * len(v))


@fault("Stream", "values", "")
class ValuesSmoothed(_Channels):
    """The mean of the last eight."""

    kept = None

    def collect(self):
        def smooth(name, values):
            both = (self.kept or {}).get(name, []) + values
            first = len(both) - len(values)
            self.kept = {**(self.kept or {}), name: both[-8:]}
            return [
                self._in_counts(name, sum(w) / len(w))
                for w in (both[max(0, first + i - 7) : first + i + 1] for i in range(len(values)))
            ]

        return changed(super().collect(), smooth)


@fault("Stream", "values", "")
class ValuesReversedInTheBlock(_Channels):
    def collect(self):
        return changed(super().collect(), lambda n, v: v[::-1])


@fault("Stream", "values", "")
class ValuesFirstOfBlock(_Channels):
    """The first value of a block is the last one of the block before."""

    kept = None

    def collect(self):
        def repeated(name, values):
            last = (self.kept or {}).get(name)
            self.kept = {**(self.kept or {}), name: values[-1] if values else last}
            return values if last is None or not values else [last, *values[1:]]

        return changed(super().collect(), repeated)


# -- times ------------------------------------------------------------------------------------------------------------


@fault("Stream", "samples", "not after")
class TimesBackwards:
    def collect(self):
        block = super().collect()
        return Block(list(block.time)[::-1], block.columns, block.host)


@fault("Stream", "samples", "not after")
class TimesAllEqual:
    def collect(self):
        block = super().collect()
        return Block([list(block.time)[-1]] * len(block.time) if len(block.time) else [], block.columns, block.host)


@fault("Stream", "samples", "not after")
class TimesInPairs:
    def collect(self):
        block = super().collect()
        times = list(block.time)
        return Block([times[i - i % 2] for i in range(len(times))], block.columns, block.host)


@fault("Stream", "samples", "computer's clock")
class TimesInMicroseconds:
    def collect(self):
        block = super().collect()
        return Block([t // 1000 for t in block.time], block.columns, block.host)


@fault("Stream", "samples", "computer's clock")
class TimesFast:
    """By a fifth."""

    def collect(self):
        block = super().collect()
        return Block([t * 6 // 5 for t in block.time], block.columns, block.host)


@fault("Stream", "samples", "apart")
class RateTwice:
    """It says another rate than it samples at."""

    def start(self, rate):
        return 2 * super().start(rate)


@fault("Stream", "samples", "apart")
class RateOfAnother:
    """It says the wanted rate, and samples at half of it."""

    def collect(self):
        block = super().collect()
        keep = slice(None, None, 2)
        return Block(list(block.time)[keep], {n: list(v)[keep] for n, v in block.columns.items()}, block.host)


@fault("Stream", "samples", "rate")
class RateNothing:
    def start(self, rate):
        super().start(rate)


@fault("Stream", "samples", "missing")
class LosesTheLastOfABlock:
    def collect(self):
        block = super().collect()
        cut = slice(None, -1)
        return Block(list(block.time)[cut], {n: list(v)[cut] for n, v in block.columns.items()}, block.host)


@fault("Stream", "samples", "there twice")
class RepeatsTheLastOfABlock:
    """Once more at the beginning of the next, a nanosecond later."""

    last = None

    def collect(self):
        block = super().collect()
        times, columns = list(block.time), {n: list(v) for n, v in block.columns.items()}
        if not times:
            return block
        if self.last is not None:
            columns = {n: [self.last[1][n], *v] for n, v in columns.items()}
            times = [self.last[0] + 1, *times]
        self.last = times[-1], {n: v[-1] for n, v in columns.items()}
        return Block(times, columns, block.host)


@fault("Stream", "samples", "not after")
class GivesABlockTwice:
    before = None

    def collect(self):
        if self.before is not None and len(self.before.time):
            block, self.before = self.before, None
            return block
        self.before = super().collect()
        return self.before


@fault("Stream", "samples", "waits for samples")
class CollectWaits:
    """For the next sample."""

    def collect(self):
        time.sleep(0.02)
        block = super().collect()
        until = time.monotonic() + 0.1
        while not len(block.time) and time.monotonic() < until:
            time.sleep(0.001)
            block = super().collect()
        return block


@fault("Stream", "samples", "changed later")
class ReusesItsLists:
    own = None

    def collect(self):
        block = super().collect()
        own = self.own = self.own or {name: [] for name in block.columns}
        for name, column in block.columns.items():
            own[name][:] = list(column)
        return Block(list(block.time), own, block.host) if len(block.time) else block


@fault("Stream", "samples", "Block.host")
class HostOfLongAgo:
    def collect(self):
        return replace(super().collect(), host=1000)


@fault("Stream", "samples", "Block.host")
class HostInTheFuture:
    def collect(self):
        block = super().collect()
        return replace(block, host=max(block.host, 0) + 10**10)


@fault("Stream", "samples", "not as many")
class LeavesAChannelOut:
    def collect(self):
        block = super().collect()
        return replace(block, columns=dict(list(block.columns.items())[1:]))


@fault("Stream", "samples", "a number is expected")
class ValuesAreText:
    def collect(self):
        return changed(super().collect(), lambda n, v: [f"{x} kPa" for x in v])


@fault("Stream", "samples", "another start")
class DoesNotStartAgain:
    """After `stop` nothing comes any more."""

    ended = False

    def stop(self):
        super().stop()
        self.ended = True

    def collect(self):
        block = super().collect()
        return Block([], {n: [] for n in block.columns}, block.host) if self.ended else block


@fault("Stream", "samples", "returned")
class StopReturnsSomething:
    def stop(self):
        super().stop()
        return True


@fault("Stream", "samples", "ValueError")
class RaisesRaw:
    """An error of Python now and then."""

    n = 0

    def collect(self):
        self.n += 1
        if self.n % 5 == 0:
            raise ValueError("could not convert string to float: ''")
        return super().collect()
