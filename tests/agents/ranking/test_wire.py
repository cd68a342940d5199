"""Messages come back as they were sent, and bytes that are none end in an error."""

import io
import struct

import numpy as np
import pytest

from agents.ranking.wire import receive, send
from slam_gym.types import Effort, Experience, Hypothesis, Posterior, Scan
from tests.rollouts import differences

HYPOTHESIS = Hypothesis(
    np.array([0, -1]), 1.5, 2, Effort(nodes=3),
    Posterior(-1.0, 0.9, np.array([-1, -1]), 0.1, np.array([0.9, 1.0])), np.array([False, True]),
    experience=Experience(1.0, 2.0, np.array([0.1, 0.2])),
)  # fmt: skip


def sent(value) -> bytes:
    file = io.BytesIO()
    send(file, value)
    return file.getvalue()


def there_and_back(value):
    return receive(io.BytesIO(sent(value)))


def test_plain_values_arrays_and_hypotheses_come_back():
    arrays = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.array([True]), "c": np.empty((0, 2))}
    assert not differences(there_and_back(arrays), arrays)
    value = {"x": [1, 2.5, None, "z", True], "nan": float("nan")}
    back = there_and_back(value)
    assert back["x"] == value["x"] and np.isnan(back["nan"]) and there_and_back(np.int64(3)) == 3
    back = there_and_back(HYPOTHESIS)
    assert back.effort == HYPOTHESIS.effort and back.exclusive and back.posterior.probability == 0.9
    np.testing.assert_array_equal(back.experience.detections, HYPOTHESIS.experience.detections)
    scan = Scan.from_points([[1.0, 2.0]], sigma=0.1)
    assert not differences(there_and_back(scan).covariances, scan.covariances)
    back.features[0] = 5  # it is the receiver's own


@pytest.mark.parametrize("value", [object(), {1: 2}, np.array(["a"]), lambda: 0, np.array([None])])
def test_code_and_objects_are_not_sent(value):
    with pytest.raises(ValueError, match="cannot be sent"):
        send(io.BytesIO(), value)


@pytest.mark.parametrize(
    "header",
    [b"{}", b"[]", b"nonsense", b'{"tree": {"class": "Popen", "fields": {}}, "arrays": []}',
     b'{"tree": {"array": 3}, "arrays": []}', b'{"tree": null, "arrays": [["|O", [1]]]}',
     b'{"tree": null, "arrays": [["<f8", [-1]]]}', b'{"tree": null, "arrays": [["<f8", [1000000000, 1000000000]]]}',
     b'{"tree": {"class": "Effort", "fields": {"no": 1}}, "arrays": []}', b"[" * 100_000],
)  # fmt: skip
def test_bytes_that_are_no_message_are_refused(header):
    with pytest.raises(ValueError):
        receive(io.BytesIO(struct.pack("<II", len(header), 0) + header))


def test_the_end_of_a_pipe_and_huge_messages_are_told_apart():
    with pytest.raises(EOFError):
        receive(io.BytesIO(sent({"a": 1})[:-1]))
    with pytest.raises(ValueError, match="bytes"):
        receive(io.BytesIO(struct.pack("<II", 2**32 - 1, 2**32 - 1)))


def test_damaged_messages_end_in_an_error_of_ours():
    whole, rng, refused = sent({"features": np.arange(5), "hypothesis": HYPOTHESIS}), np.random.default_rng(0), 0
    for _ in range(500):
        damaged = bytearray(whole)
        for at in rng.integers(len(whole), size=rng.integers(1, 4)):
            damaged[at] = rng.integers(256)
        try:
            receive(io.BytesIO(bytes(damaged)))
        except (ValueError, EOFError):
            refused += 1
    assert 100 < refused < 500  # the rest damages a number, which nobody can know
