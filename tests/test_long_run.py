"""The long run in its shortest form: a few episodes with extreme settings."""

import pytest

from benchmarks.long_run import checked, episode


@pytest.mark.parametrize(
    ("number", "associator"), [*((number, "") for number in (0, 1, 5, 8, 14, 29)), (2, "jcbb"), (3, "learned")]
)
def test_nothing_breaks(number: int, associator: str) -> None:
    words, env = episode(number, 0, 24, associator)
    assert sum(step.ticks for step in checked(env, number)) > 0, words
