"""Kernels as other kernels call them: code that is only ever linked into theirs, and kept on disk as well.

What one process has compiled of a kernel, another one that compiles a kernel around it takes from the cache: so two
processes share the work even where both come to the same inner functions.
"""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import llvmlite.binding
import numba
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import Cache, CompileResultCacheImpl
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult
from numba.core.registry import CPUDispatcher

from slam_gym._claims import claimed

PART = "part-"  # files of parts begin with that

_numbering: int | None = None  # process whose functions are numbered


class _Part(JITCodeLibrary):  # type: ignore[misc]
    """Code that is only ever linked into that of others, with which it is emitted.

    It is optimised before, although that is done again there: otherwise steps would take a twentieth longer.
    """

    def _finalize_final_module(self: Any) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    @classmethod
    def from_bitcode(cls, codegen: Any, name: str, bitcode: bytes) -> Any:
        """As it was when its module was turned into that."""
        part: Any = cls(codegen, name)
        part._final_module = llvmlite.binding.parse_bitcode(bitcode)
        part._finalize_final_module()
        return part


class PartCompiler(Compiler):  # type: ignore[misc]
    """numba's pipeline into a `_Part`, which is known by a key where others are known by their machine code."""

    def compile_extra(self, func: Callable[..., object]) -> Any:
        _number_functions()
        state, part, key = self.state, cast(Any, _Part), object()
        state.library, state.flags.no_compile = part(state.targetctx.codegen(), func.__qualname__), True
        result = cast(Any, super()).compile_extra(func)
        state.targetctx.insert_user_function(key, result.fndesc, [result.library])
        return result._replace(entry_point=key)


class ApartCompiler(PartCompiler):
    """The same for a function whose arrays do not overlap: its loops need not find out whether they do."""

    def compile_extra(self, func: Callable[..., object]) -> Any:
        cast(Any, self).state.flags.noalias = True
        return super().compile_extra(func)


class Called(CPUDispatcher):  # type: ignore[misc]
    """A kernel as other kernels call it."""

    def __init__(
        self,
        py_func: Callable[..., object],
        locals: dict[str, Any] | None = None,
        targetoptions: dict[str, Any] | None = None,
        pipeline_class: type[Compiler] = PartCompiler,
    ) -> None:
        super().__init__(py_func, locals, targetoptions, pipeline_class)
        self._folder: Path | None = None
        self._asked = False  # numba for a cache there, which takes time

    def cache_in(self, folder: Path) -> None:
        """Keep what is compiled in a folder; it is looked at when there is something to compile."""
        self._folder = folder

    def compile(self, sig: Any) -> Any:
        if tuple(sig) in self.overloads or self._folder is None:
            return super().compile(sig)
        if not self._asked:
            cache, self._asked = cast(Any, _PartCache), True
            with caching_into(self._folder):
                self._cache = cache(self.py_func)
        with claimed(self._folder, PART + self.py_func.__qualname__):
            return super().compile(sig)

    def add_overload(self, cres: Any) -> None:
        self.overloads[tuple(cres.signature.args)] = cres


@contextlib.contextmanager
def caching_into(folder: Path) -> Iterator[None]:
    """Meanwhile numba takes a folder for the one that caches are in."""
    config: Any = numba.config
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
    try:
        yield
    finally:
        config.CACHE_DIR = before


class _PartCacheImpl(CompileResultCacheImpl):  # type: ignore[misc]
    """Bitcode instead of machine code."""

    def reduce(self, cres: Any) -> tuple[Any, ...]:
        cres.fndesc.typemap = cres.fndesc.calltypes = None  # as numba does: not needed any more
        library, environments = cres.library, tuple(cres._find_referenced_environments())
        kept = cres.fndesc, cres.environment, cres.signature, cres.reload_init, environments
        return library.name, library._final_module.as_bitcode(), *kept

    def rebuild(self, target_context: Any, payload: tuple[Any, ...]) -> Any:
        name, bitcode, fndesc, environment, signature, reload_init, environments = payload
        for function in reload_init:
            function()
        result: Any = CompileResult
        return result(
            typing_context=target_context.typing_context, target_context=target_context, entry_point=object(),
            typing_error=None, type_annotation="", signature=signature, objectmode=False, lifted=(), fndesc=fndesc,
            library=_Part.from_bitcode(target_context.codegen(), name, bitcode), call_helper=None,
            environment=environment, metadata=None, reload_init=reload_init, referenced_envs=environments,
        )  # fmt: skip

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        return PART + str(cast(Any, super()).get_filename_base(fullname, abiflags))


class _PartCache(Cache):  # type: ignore[misc]
    _impl_class: Any = _PartCacheImpl


def _number_functions() -> None:
    """Have numba number functions, by which it tells their code apart, otherwise than other processes do."""
    global _numbering
    if _numbering != os.getpid():
        _numbering = os.getpid()
        cast(Any, FunctionIdentity)._unique_ids = itertools.count(int.from_bytes(os.urandom(5), "big") << 20)
