"""The long run in its shortest form: a few episodes with extreme settings."""

import pytest

from benchmarks.long_run import checked, episode


@pytest.mark.parametrize("number", (0, 1, 5, 8, 14, 29))
def test_nothing_breaks(number: int) -> None:
    words, env = episode(number, 0, 24)
    assert sum(checked(env, number)) > 0, words
