"""`dataclass` of the standard library, where frozen classes are made in a fraction of the time.

The library compiles six methods for each frozen class, which takes 0.7 ms, and a command loads a hundred of them. Here
only `__init__` is compiled, for the first instance; the other methods are the same functions for all classes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import MISSING, FrozenInstanceError, fields
from operator import attrgetter
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls: type | None = None, /, *, frozen: bool = False, eq: bool = True, **options: Any) -> Any:
        """As `dataclasses.dataclass`; the signature of a frozen class is known from its first instance on."""
        if not frozen or options.keys() - {"kw_only"}:
            return dataclasses.dataclass(cls, frozen=frozen, eq=eq, **options)

        def made(cls: type) -> type:
            dataclasses.dataclass(init=False, repr=False, eq=False, **options)(cls)

            def at_first(self: Any, *values: Any, **named: Any) -> None:
                cls.__init__ = _initialiser(cls)
                cls.__init__(self, *values, **named)

            methods = {
                "__init__": at_first,
                "__repr__": _shown,
                "__setattr__": _refuse,
                "__delattr__": _refuse,
            }
            if eq:
                names = [field.name for field in fields(cls) if field.compare]
                methods |= {"_compared": attrgetter(*names) if names else type, "__eq__": _equal, "__hash__": _hash}
            own = vars(cls)
            for name, method in methods.items():
                if name not in own or (name == "__hash__" and own[name] is None):
                    setattr(cls, name, method)
            return cls

        return made if cls is None else made(cls)


def _initialiser(cls: type) -> Callable[..., None]:
    """`__init__` of a frozen class, compiled for its fields."""
    head, body, known = ["self"], list[str](), dict[str, Any](_absent=MISSING, _set=object.__setattr__)
    for field in sorted((field for field in fields(cls) if field.init), key=lambda field: bool(field.kw_only)):
        name = value = field.name
        if field.kw_only and "*" not in head:
            head.append("*")
        if field.default_factory is not MISSING:
            known[f"_make_{name}"] = field.default_factory
            head.append(f"{name}=_absent")
            value = f"_make_{name}() if {name} is _absent else {name}"
        elif field.default is not MISSING:
            known[f"_else_{name}"] = field.default
            head.append(f"{name}=_else_{name}")
        else:
            head.append(name)
        body.append(f"_set(self, {name!r}, {value})")
    then = "self.__post_init__()" if hasattr(cls, "__post_init__") else "pass"
    exec(f"def __init__({', '.join(head)}):\n " + "\n ".join([*body, then]), known)  # noqa: S102 - as the library does
    made: Callable[..., None] = known["__init__"]
    made.__qualname__ = f"{cls.__qualname__}.__init__"
    return made


@recursive_repr()
def _shown(self: Any) -> str:
    values = (f"{field.name}={getattr(self, field.name)!r}" for field in fields(self) if field.repr)
    return f"{type(self).__qualname__}({', '.join(values)})"


def _refuse(self: Any, name: str, *_: Any) -> None:
    raise FrozenInstanceError(f"cannot assign to or delete field {name!r}")


def _equal(self: Any, other: Any) -> Any:
    return self._compared(self) == self._compared(other) if type(other) is type(self) else NotImplemented


def _hash(self: Any) -> int:
    return hash(self._compared(self))
