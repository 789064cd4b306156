"""Our `dataclass` makes classes that behave as those of the standard library, which is the reference here."""

import copy
import dataclasses
import pickle
from dataclasses import FrozenInstanceError, field
from functools import cached_property

import pytest

from pmabench.base.dataclass import dataclass

BY = (dataclasses.dataclass, dataclass)


def made(by):
    """The same classes by either decorator."""

    @by(frozen=True)
    class Point:
        """A point."""

        x: float
        y: float = 2.0
        names: list[str] = field(default_factory=list, compare=False)
        hidden: int = field(default=0, repr=False)

        @cached_property
        def sum(self):
            return self.x + self.y

    @by(frozen=True)
    class Further(Point):
        """With a field more, and its own text."""

        z: float = 3.0

        def __post_init__(self):
            object.__setattr__(self, "hidden", 7)

        def __repr__(self):
            return "further"

    @by(frozen=True, eq=False, kw_only=True)
    class Alone:
        """Compared by identity."""

        b: int = 1
        a: int

    @by(frozen=True)
    class Empty:
        """No field."""

    return Point, Further, Alone, Empty


@pytest.mark.parametrize("by", BY)
def test_frozen_classes_behave_as_those_of_the_library(by):
    Point, Further, Alone, Empty = made(by)
    one, same = Point(1.0, names=["a"]), Point(x=1.0, names=["b"])
    assert one == same
    assert hash(one) == hash(same)
    assert one != Point(1.0, 2.5)
    assert one != (1.0, 2.0)
    assert one != Further(1.0)
    assert Further(1.0) == Further(1.0, hidden=3)
    assert repr(one).endswith("Point(x=1.0, y=2.0, names=['a'])")
    assert repr(Further(1.0)) == "further"
    assert Further(1.0).hidden == 7
    assert Point(1.0).names is not Point(1.0).names
    assert one.sum == 3.0
    assert Empty() == Empty()
    assert Alone(a=1) != Alone(a=1)
    assert Alone(a=1).b == 1
    assert [f.name for f in dataclasses.fields(Further)] == ["x", "y", "names", "hidden", "z"]
    assert dataclasses.replace(one, y=4.0) == Point(1.0, 4.0)
    assert dataclasses.asdict(one) == {"x": 1.0, "y": 2.0, "names": ["a"], "hidden": 0}
    assert copy.copy(one) == one
    match one:
        case Point(x, y):
            assert (x, y) == (1.0, 2.0)


@pytest.mark.parametrize("by", BY)
def test_frozen_classes_refuse_what_those_of_the_library_refuse(by):
    Point, _, Alone, _ = made(by)
    one = Point(1.0)
    for change in (lambda: setattr(one, "x", 2.0), lambda: setattr(one, "new", 2.0), lambda: delattr(one, "x")):
        with pytest.raises(FrozenInstanceError):
            change()
    for wrong in (lambda: Point(), lambda: Point(1.0, w=2.0), lambda: Alone(1), lambda: Alone()):
        with pytest.raises(TypeError):
            wrong()
    with pytest.raises(TypeError):
        hash(Point([1.0]))


@dataclass(frozen=True)
class Stored:
    """At the top of a module, as `pickle` asks."""

    x: float
    more: tuple[int, ...] = ()


def test_frozen_classes_can_be_pickled():
    assert pickle.loads(pickle.dumps(Stored(1.0, (2,)))) == Stored(1.0, (2,))


def test_other_classes_are_those_of_the_library():
    @dataclass
    class Counted:
        """May change."""

        n: int = 0

    @dataclass(frozen=True, order=True)
    class Ordered:
        """In order."""

        n: int

    counted = Counted()
    counted.n += 1
    assert counted == Counted(1)
    assert Ordered(1) < Ordered(2)
