"""The outline of a union of rectangles against counting pixels."""

import numpy as np
import pytest

from slam_gym.world.outline import outline


def random_rectangles(rng, count):
    low = rng.integers(0, 12, (count, 2))
    return np.hstack([low, low + rng.integers(1, 6, (count, 2))]).astype(float)


def paint(free, blocked, size=20):
    image = np.zeros((size, size), dtype=bool)
    for rectangles, value in ((free, True), (blocked, False)):
        for x1, y1, x2, y2 in rectangles.astype(int):
            image[y1 + 1 : y2 + 1, x1 + 1 : x2 + 1] = value
    return image


@pytest.mark.parametrize("seed", range(60))
def test_agrees_with_pixels(seed):
    rng = np.random.default_rng(seed)
    free, blocked = random_rectangles(rng, rng.integers(1, 7)), random_rectangles(rng, rng.integers(0, 4))
    image = paint(free, blocked)
    walls, corners, shorter = outline(free, blocked)

    edges = set()  # unit edges between a free and a blocked pixel
    for y, x in zip(*np.nonzero(image[:, 1:] != image[:, :-1])):
        edges.add((x, y - 1, x, y))
    for y, x in zip(*np.nonzero(image[1:] != image[:-1])):
        edges.add((x - 1, y, x, y))
    covered = []
    for x1, y1, x2, y2 in walls.astype(int):
        steps = max(x2 - x1, y2 - y1)
        dx, dy = (x2 - x1) // steps, (y2 - y1) // steps
        covered += [(x1 + i * dx, y1 + i * dy, x1 + (i + 1) * dx, y1 + (i + 1) * dy) for i in range(steps)]
    assert len(covered) == len(set(covered))
    assert set(covered) == edges

    ends = {tuple(end) for end in walls.reshape(-1, 2)}
    assert ends == {tuple(corner) for corner in corners}
    assert len(ends) == len(corners)
    for corner, length in zip(corners, shorter):
        meeting = walls[(walls[:, :2] == corner).all(axis=1) | (walls[:, 2:] == corner).all(axis=1)]
        lengths = np.abs(meeting[:, 2:] - meeting[:, :2]).sum(axis=1)
        level = meeting[:, 1] == meeting[:, 3]
        assert len(meeting) in (2, 4) and level.sum() == len(meeting) // 2  # an L, or two of them at a diagonal
        assert length == lengths.min()
