"""Frozen dataclasses that are quick to make, for what is made at every step."""

from __future__ import annotations

from dataclasses import MISSING, Field, fields
from typing import Any, TypeVar

T = TypeVar("T")


def quick(cls: type[T]) -> type[T]:
    """The same frozen dataclass with slots, made in a fraction of the time. No class is to be derived from it.

    A frozen dataclass enters each field by `object.__setattr__`, since its own refuses to. Here an instance is of an
    open twin of the class, with the same slots, until its fields are filled in; so it is `__new__` that makes it.
    """
    names = [field.name for field in fields(cls)]  # type: ignore[arg-type]
    known: dict[str, Any] = {"MISSING": MISSING, "twin": type(f"_Open{cls.__name__}", (), {"__slots__": tuple(names)})}
    entered = [_entered(field, known) for field in fields(cls)]  # type: ignore[arg-type]
    lines = ["self = twin()", *(line for _, line in entered), "self.__class__ = cls"]
    if hasattr(cls, "__post_init__"):
        lines.append("self.__post_init__()")
    lines.append("return self")
    exec(f"def __new__(cls, {', '.join(given for given, _ in entered)}):\n    " + "\n    ".join(lines), known)
    changing: Any = cls
    del changing.__init__  # that of `object` is left, which does nothing
    changing.__new__ = known["__new__"]
    changing.__reduce__ = lambda self: (type(self), tuple([getattr(self, name) for name in names]))
    return cls


def _entered(field: Field[Any], known: dict[str, Any]) -> tuple[str, str]:
    """How a field stands in the signature, and the line that fills it in."""
    name = field.name
    if field.default_factory is not MISSING:
        known[f"new_{name}"] = field.default_factory
        return f"{name}=MISSING", f"self.{name} = new_{name}() if {name} is MISSING else {name}"
    if field.default is MISSING:
        return name, f"self.{name} = {name}"
    known[f"default_{name}"] = field.default
    return f"{name}=default_{name}", f"self.{name} = {name}"
