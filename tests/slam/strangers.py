"""What a stranger's associator can get hold of, starting from what it is handed."""

import gc
from collections.abc import Iterator
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType

import numpy as np
from numba.core.dispatcher import Dispatcher

CODE = (type, ModuleType, BuiltinFunctionType, Dispatcher)


def reachable(*roots: object) -> Iterator[object]:
    """All objects behind `roots`: by attributes, in closures and defaults, and whatever the garbage collector knows.

    Types, modules, compiled functions and the globals of functions are code: everybody can import those.
    """
    todo, seen = list(roots), {}
    while todo:
        thing = todo.pop()
        if id(thing) in seen or isinstance(thing, CODE):
            continue
        seen[id(thing)] = thing  # kept alive, so that no other gets its id
        yield thing
        todo += _behind(thing)


def _behind(thing: object) -> list[object]:
    if isinstance(thing, FunctionType):
        cells = [cell.cell_contents for cell in thing.__closure__ or ()]
        return [*cells, thing.__defaults__, thing.__kwdefaults__, thing.__dict__]
    if isinstance(thing, MethodType):
        return [thing.__self__, thing.__func__]
    if isinstance(thing, (np.ndarray, memoryview)):  # which the garbage collector does not know
        return [getattr(thing, "base", None), getattr(thing, "obj", None)]
    return gc.get_referents(thing)
