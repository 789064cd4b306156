"""The safe state: the declared actions in their order, advanced step by step, never cancelled."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import inf

from pmabench.base.quantities import QUANTITIES, without_number
from pmabench.bench.interface import SafeAction
from pmabench.guard.owner import PATIENCE, Call

AT_ONCE = ("set", "stop", "open", "close")
NO_EFFECT = 0.7
"""A measured value that has not fallen by a fiftieth so long [s] after the last command shows no effect of it."""
ANSWERS = 5 * PATIENCE
"""How long an answer whether a command is held is waited for [s].

Without one the command counts as not carried out; over the second way, whose line may hang, it counts as sent.
"""
REPEAT = 0.5
"""While a confirmation is waited for, the commands are sent again so often [s]; they are absolute."""
STAYS = 0.5
"""A value must stay low for so long [s] after the last command: a valve may be about to open for the one before."""
LINGERS = 3.0
"""A command that was not answered may be carried out so much later [s]; those of the safe state are sent until then."""


@dataclass(frozen=True)
class Vent:
    """What came of the safe state: `confirmed`, `commanded` (not confirmed) or `failed`, and each action's outcome."""

    result: str
    actions: tuple[str, ...]

    @property
    def confirmed(self) -> bool:
        """Whether a measured value says that the bench is safe."""
        return self.result == "confirmed"


@dataclass
class _Sent:
    action: SafeAction
    call: Call
    since: float
    rescue: Call | None = None
    look: Call | None = None
    """Whether the device holds what it acknowledged: an empty text, or a sentence."""


class SafeState:
    """One pass through the actions.

    `begin` starts an action (the result of a ramp is how long it takes [s]) and `rescue` tries it over a second way;
    `look` asks whether a command is held (None: it cannot be asked); all return at once. Commands that follow each
    other go out together; `ramp`, `hold` and `confirm` are waited for until they are done or their time is over. A
    value at or below its entry in `floors` [SI] confirms nothing, nor does any within `LINGERS` after `unanswered` [s].
    """

    def __init__(
        self,
        actions: tuple[SafeAction, ...],
        begin: Callable[[SafeAction], Call],
        rescue: Callable[[SafeAction], Call | None],
        look: Callable[[SafeAction], Call | None],
        now: float,
        floors: Mapping[str, float] | None = None,
        unanswered: float = -inf,
    ) -> None:
        self._floors = floors or {}
        self._todo = list(actions)
        self._begin, self._rescue, self._look = begin, rescue, look
        self._sent: list[_Sent] = []
        self._since = self._repeated = now
        self._ramp: Call | None = None
        self._confirms = sum(action.do == "confirm" for action in actions)
        self._confirmed = 0
        self._first: float | None = None
        """First value that was measured for this confirmation."""
        self._newest: float | None = None
        self._fallen = False
        self._low: float | None = None
        """Since when the value has stayed low [s]."""
        self._late = unanswered + LINGERS
        self.outcome: list[str] = []
        self.failed: set[str] = set()
        """Targets of commands that failed or were not carried out."""
        self.unmoved = False
        """Whether a measured value has not fallen after all commands."""
        self._commands: list[SafeAction] = []
        """What was commanded so far, a ramp by its end."""
        self.vent: Vent | None = None
        """What came of it, when it is over."""

    @property
    def without_effect(self) -> bool:
        """Whether a command or the whole has no effect: no device gets a sign of life any more (S13)."""
        return bool(self.failed) or self.unmoved

    def hurry(self) -> None:
        """Skip the waits: send every command that is left now, and wait for confirmations only."""
        todo = [replace(a, do="set") if a.do == "ramp" else a for a in self._todo if a.do != "hold"]
        self._todo = sorted(todo, key=lambda action: action.do == "confirm")

    def step(self, now: float, latest: Mapping[str, float]) -> bool:
        """Do what can be done now, with the `latest` measured values [SI]; whether it is over."""
        self._gather(now)
        while self._todo and self._advance(self._todo[0], now, latest):
            self._todo.pop(0)
            self._gather(now)
            self._since = self._repeated = now
            self._ramp, self._first, self._newest, self._fallen, self._low = None, None, None, False, None
        if self.vent is None and not self._todo and not self._sent:
            result = "failed" if self.failed else "commanded"
            if self._confirms and self._confirmed == self._confirms:
                result = "confirmed"
            self.vent = Vent(result, tuple(self.outcome))
        return self.vent is not None

    def _advance(self, action: SafeAction, now: float, latest: Mapping[str, float]) -> bool:
        """Whether the next action may begin."""
        if action.do == "confirm":
            return self._confirm(action, now, latest)
        if action.do in AT_ONCE or (action.do == "ramp" and self._ramp is None):
            self._sent.append(_Sent(action, self._begin(action), now))
            self._commands.append(replace(action, do="set") if action.do == "ramp" else action)
            if action.do in AT_ONCE:
                return True
            self._ramp = self._sent[-1].call
        if self._ramp is not None and self._ramp.error is not None:
            return True
        lasts = self._ramp.result if self._ramp is not None else None
        return now - self._since >= min(action.within, action.within if lasts is None else lasts)

    def _confirm(self, action: SafeAction, now: float, latest: Mapping[str, float]) -> bool:
        value = latest.get(action.target)
        self._newest = self._newest if value is None else value
        low = value is not None and self._floors.get(action.target, -inf) < value < action.value
        if self._sent or (value is not None and not low):
            self._low = None
        elif low and self._low is None:
            self._low = max(now, self._late)
        if value is not None and low and self._low is not None and now - self._low >= STAYS:
            self._confirmed += 1
            self.outcome.append(f"confirm {action.target}: {_shown(action, value)}, below {_shown(action)}")
            return True
        if now >= max(self._since + action.within, 0.0 if self._low is None else self._low + 2 * STAYS):
            bound = f"below {_shown(action)} within {action.within:g} s"
            measured = "nothing measured" if self._newest is None else _shown(action, self._newest)
            if self._newest is not None and self._newest < action.value:
                measured += ", and not for long" if self._low is not None else ", which a broken wire reads"
            self.outcome.append(f"confirm {action.target}: {measured}, not {bound}")
            return True
        if value is not None:
            self._fallen = low or (self._first is not None and value < 0.98 * self._first)
            self._first = value if self._first is None else self._first
        self.unmoved = self.unmoved or (now - self._since >= NO_EFFECT and not self._fallen)
        if now - self._repeated >= REPEAT and (not low or now < self._late):
            self._repeated = now
            for command in self._commands:
                self._begin(command)
        return False

    def _gather(self, now: float) -> None:
        """Note the results of the commands under way; one without success is repeated over the second way."""
        self._sent = [again for sent in self._sent if (again := self._follow_up(sent, now)) is not None]

    def _follow_up(self, sent: _Sent, now: float) -> _Sent | None:
        """The command as it is waited for further, or None where it is settled."""
        way = sent.rescue or sent.call
        name = f"{sent.action.do} {sent.action.target}"
        acknowledged = any(call.done.is_set() and call.error is None for call in (sent.call, way))
        if acknowledged:
            wrong = self._not_held(sent, now)
            if wrong is None:
                return sent
            if not wrong:
                self.outcome.append(f"{name}: sent" if sent.rescue is None else f"{name}: sent over the second way")
                return None
        else:
            wrong = str(way.error or "no answer")
        over = acknowledged or way.done.is_set() or now - sent.since >= PATIENCE
        second = self._rescue(sent.action) if sent.rescue is None and (over or sent.call.behind) else None
        if second is not None:
            return _Sent(sent.action, second if acknowledged else sent.call, now, second)
        if not over:
            return sent
        self.failed.add(sent.action.target)
        self.outcome.append(f"{name}: failed ({wrong})")
        return None

    def _not_held(self, sent: _Sent, now: float) -> str | None:
        """Why the device does not hold what it acknowledged; empty where it does or cannot say; None: not known yet."""
        if self._todo and self._todo[0].do in AT_ONCE:
            return None  # first everything that is to be commanded now
        if sent.look is None or (sent.look.done.is_set() and sent.look.error is not None):
            sent.look = self._look(sent.action)  # again where it failed: the second way may have made a new connection
        if sent.look is None:
            return ""
        if sent.look.done.is_set() and sent.look.error is None:
            return sent.look.result or ""
        if now - sent.since < ANSWERS:
            return None
        return "" if sent.rescue is not None else "acknowledged, and no answer whether it is held"


def _shown(action: SafeAction, value: float | None = None) -> str:
    """What is measured, or else the bound, in the unit that people read; in SI where the channel's name has none."""
    quantity = QUANTITIES.get(without_number(action.target)[0])
    shown = action.value if value is None else value
    return f"{shown:.4g}" if quantity is None else quantity.show(shown, 4)
