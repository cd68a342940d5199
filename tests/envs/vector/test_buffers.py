"""The block of memory: every array in it has its place, and another mapping of it shows what was written."""

import numpy as np
import pytest
from gymnasium import spaces

from slam_gym.envs.vector.buffers import Layout, SharedBlock, opened

OBSERVATION = spaces.Dict({
    "image": spaces.Box(0, 255, (3, 5, 5), np.uint8), "scan": spaces.Box(-1.0, 1.0, (7,), np.float32),
})  # fmt: skip


@pytest.mark.parametrize("action", [spaces.Discrete(4), spaces.Box(-1.0, 1.0, (2,), np.float32)])
def test_arrays_do_not_overlap_and_have_the_shapes_of_their_spaces(action) -> None:
    layout = Layout.of(OBSERVATION, action, 3)
    buffers = layout.buffers(bytearray(layout.size))
    arrays = [*buffers[:-1], *buffers.observations.values()]
    for k, array in enumerate(arrays):
        array.view(np.uint8).fill(k % 2)  # flags have two values
        assert len(array) == 3 and array.ctypes.data % 8 == 0
    assert all((array.view(np.uint8) == k % 2).all() for k, array in enumerate(arrays))
    assert not any(np.shares_memory(a, b) for i, a in enumerate(arrays) for b in arrays[:i])
    assert buffers.actions.shape == (3, *action.shape)
    assert {name: part.shape[1:] for name, part in buffers.observations.items()} == {"image": (3, 5, 5), "scan": (7,)}


def test_rows_are_views() -> None:
    layout = Layout.of(OBSERVATION, spaces.Discrete(4), 4)
    buffers = layout.buffers(bytearray(layout.size))
    of_two = buffers.of(range(2, 4))
    of_two.rewards[:] = 3.0
    of_two.observations["scan"][1] = 0.5
    assert buffers.rewards.tolist() == [0.0, 0.0, 3.0, 3.0]
    assert buffers.observations["scan"][3].tolist() == [0.5] * 7


def test_a_shared_block_is_seen_by_whoever_opened_it_after_its_file_is_gone() -> None:
    layout = Layout.of(OBSERVATION, spaces.Discrete(4), 2)
    block = SharedBlock(layout.size)
    there = layout.buffers(opened(block.path, layout.size))
    block.forget()
    block.forget()
    assert not block.path.exists()
    layout.buffers(block.memory).rewards[1] = 2.5
    assert there.rewards.tolist() == [0.0, 2.5]
