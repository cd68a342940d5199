"""How kernels are compiled: machine code is made of what Python calls, once, with all that it calls in turn.

Left to itself, numba makes machine code of every function, and again of it within each of its callers, so that what
lies five calls deep is optimised and emitted six times, and wrapped for Python as often. Here a kernel has two
dispatchers: its own, which Python calls, and a `_Called`, which other kernels get in its place. The latter's code is
linked into theirs. No kernel may call itself.

Processes that fill a cache at the same time wait for each other's kernels instead of compiling them as well.
"""

from __future__ import annotations

import contextlib
import gc
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows: each process compiles for itself
    fcntl = None


class _Part(JITCodeLibrary):  # type: ignore[misc]
    """Code that is only ever linked into that of others, with which it is emitted.

    It is optimised before, although that is done again there: otherwise steps would take a twentieth longer.
    """

    def _finalize_final_module(self: Any) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _PartCompiler(Compiler):  # type: ignore[misc]
    """numba's pipeline into a `_Part`, which is known by a key where others are known by their machine code."""

    def compile_extra(self, func: Callable[..., object]) -> Any:
        state, part, key = self.state, cast(Any, _Part), object()
        state.library, state.flags.no_compile = part(state.targetctx.codegen(), func.__qualname__), True
        result = cast(Any, super()).compile_extra(func)
        state.targetctx.insert_user_function(key, result.fndesc, [result.library])
        return result._replace(entry_point=key)


class _ApartCompiler(_PartCompiler):
    """The same for a function whose arrays do not overlap: its loops need not find out whether they do."""

    def compile_extra(self, func: Callable[..., object]) -> Any:
        cast(Any, self).state.flags.noalias = True
        return super().compile_extra(func)


class _Called(CPUDispatcher):  # type: ignore[misc]
    """A kernel as other kernels call it."""

    def add_overload(self, cres: Any) -> None:
        self.overloads[tuple(cres.signature.args)] = cres


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
        self._called = _Called(py_func, locals, options, pipeline_class=_ApartCompiler if apart else _PartCompiler)
        self._claims: Path | None = None

    def cache_in(self, folder: Path) -> None:
        """Keep what is compiled in a folder, which numba has been told of."""
        self.enable_caching()
        self._claims = folder / "claims"

    def compile(self, sig: Any) -> Any:
        with _claimed(self._claims, self.py_func.__qualname__), _garbage_left():
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
def _claimed(claims: Path | None, name: str) -> Iterator[None]:
    """While no other process compiles the kernel of this name, where the system can lock bytes of a file."""
    with contextlib.ExitStack() as stack:
        if claims is not None and fcntl is not None:
            with contextlib.suppress(OSError):
                file = stack.enter_context(claims.open("ab"))  # which unlocks when it is closed
                fcntl.lockf(file, fcntl.LOCK_EX, 1, zlib.crc32(name.encode()))
        yield


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
