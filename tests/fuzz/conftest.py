"""How many inputs an attack tries, and a place where the counts are told."""

from collections import Counter
from collections.abc import Callable, Iterator

import pytest

_COUNTS: dict[str, Counter[str]] = {}


@pytest.fixture
def inputs(request: pytest.FixtureRequest) -> int:
    """For each reader."""
    return request.config.getoption("--fuzz")


@pytest.fixture
def count(request: pytest.FixtureRequest) -> Iterator[Callable[[Counter[str]], None]]:
    """Remembers what an attack came to; with `-s` it is told at once."""
    counts = _COUNTS.setdefault(request.node.name, Counter())

    def add(more: Counter[str]) -> None:
        counts.update(more)

    yield add
    assert counts.total() > 0, "nothing was tried"
    print(f"\n{request.node.name}: {counts.total()} inputs, {counts['read']} read, {counts['refused']} refused")
