"""What the readers of logs share."""

import numpy as np

from slam_gym.recordings.reading import Spans, starts_of


def test_spans_are_cut_where_commands_take_over() -> None:
    looks, commands = np.array([0.0, 1.0, 1.0, 4.0]), np.array([0.5, 1.0, 2.5, 2.5, 9.0])
    spans = Spans.between(looks, commands)
    assert spans.step.tolist() == [1, 1, 3, 3] and spans.command.tolist() == [-1, 0, 1, 3]
    assert spans.sums(spans.seconds, 4).tolist() == [0.0, 1.0, 0.0, 3.0]
    assert spans.headings(np.array([1.0, 2.0, 4.0, 8.0])).tolist() == [0.0, 1.0, 0.0, 4.0]
    assert len(Spans.between(looks[:1], commands).step) == 0


def test_steps_start_where_those_before_them_end() -> None:
    assert starts_of([2, 0, 3]).tolist() == [0, 2, 2, 5] and starts_of([]).tolist() == [0]
    assert starts_of(np.array([True, False, True])).dtype == np.int64
