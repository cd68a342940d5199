"""How kernels are compiled: machine code is made of what Python calls, once, with all that it calls in turn.

Left to itself, numba makes machine code of every function, and again of it within each of its callers, so that what
lies five calls deep is optimised and emitted six times, and wrapped for Python as often. Here a kernel has two
dispatchers: its own, which Python calls, and a `Called`, which other kernels get in its place. The latter's code is
linked into theirs. No kernel may call itself.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from numba.core.registry import CPUDispatcher

from slam_gym._claims import claimed
from slam_gym._parts import ApartCompiler, Called, PartCompiler
from slam_gym._typing import resolved_once


class Kernel(CPUDispatcher):  # type: ignore[misc]
    """A kernel as Python calls it."""

    def __init__(
        self,
        py_func: Callable[..., object],
        locals: dict[str, Any] | None,
        targetoptions: dict[str, Any],
        apart: bool = False,
    ) -> None:
        super().__init__(py_func, locals, targetoptions | {"no_cfunc_wrapper": True})  # no C code calls it
        options = targetoptions | {"no_cfunc_wrapper": True, "no_cpython_wrapper": True}
        self._called = Called(py_func, locals, options, ApartCompiler if apart else PartCompiler)
        self._folder: Path | None = None

    def cache_in(self, folder: Path) -> None:
        """Keep what is compiled in a folder, which numba has been told of."""
        self.enable_caching()
        self._called.cache_in(folder)
        self._folder = folder

    def compile(self, sig: Any) -> Any:
        with claimed(self._folder, self.py_func.__qualname__, busy=True), _garbage_left(), resolved_once():
            return super().compile(sig)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return self._called.get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        return self._called.get_overload(sig)

    def add_overload(self, cres: Any) -> None:
        super().add_overload(cres)
        for environment in cres._find_referenced_environments():  # of the parts, which nobody has loaded yet
            cres.library.codegen.set_env(environment.env_name, environment)


@contextlib.contextmanager
def _garbage_left() -> Iterator[None]:
    """Without collection of garbage, which takes an eighth of the time of a compilation."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
