"""Which implementation of an operator goes with which types, asked of numba once.

To type `x + y`, numba goes through everything that `+` may stand for, for each place where it stands and each time that
it looks at that place again: a third of what it takes to compile a kernel, were it not for this.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from numba.core.compiler_lock import global_compiler_lock
from numba.core.targetconfig import ConfigStack
from numba.core.types.functions import BaseFunction

_resolve: Any = BaseFunction.get_call_type
_resolved: dict[Any, tuple[Any, ...]] = {}


def _get_call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:
    """The signature that numba finds, and in `_impl_keys` what implements it: that depends on the options as well."""
    stack: Any = ConfigStack
    flags = stack.top_or_none()
    options = None if flags is None else tuple((name, str(value)) for name, value in flags._values.items())
    key = id(self), id(context), args, tuple(kws.items()), options
    found = _resolved.get(key)
    if found is None:
        signature = _resolve(self, context, args, kws)
        _resolved[key] = signature, self._impl_keys[signature.args], self, context  # whose ids are not given again
        return signature
    signature, implementation, _, _ = found
    self._impl_keys[signature.args] = implementation
    return signature


@contextlib.contextmanager
def resolved_once() -> Iterator[None]:
    """Meanwhile numba remembers what it has found; what it finds is the same."""
    cls: Any = BaseFunction
    with global_compiler_lock:
        before, cls.get_call_type = cls.get_call_type, _get_call_type
        try:
            yield
        finally:
            cls.get_call_type = before
