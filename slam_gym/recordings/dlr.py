"""The DLR log: a robot drives 505 m through a building and sees artificial circles on its floor, all of them labelled.

The reader needs the published file `map.circles` (see `SOURCE`), gzipped or not.

In the file, the robot looks along −Y and has X to its right. Turned by a right angle, x' = −y and y' = x, it looks
along X, as in this package. The map is then the mirror image of the building, but consistent.
"""

import math
from pathlib import Path

import numpy as np

from slam_gym._files import content_of
from slam_gym.recordings.recording import Recording, RecordingError, naming, published_file, starts_of
from slam_gym.types import SPURIOUS, UNLABELLED, Array

SOURCE = (
    "DLR Spatial Cognition, J. Kurlbaum and U. Frese, University of Bremen and DLR. Cite: Kurlbaum and Frese, 'A "
    "Benchmark Data Set for Data Association', SFB/TR 8 Spatial Cognition, 2009."
)
TERMS = "No licence is published for the data: ask the authors before you pass it on."
FILE = "map.circles"
_RANGE, _FIELD_OF_VIEW = 4.5, math.radians(120.0)  # [m], [rad] of the camera on the floor
_STEP, _CIRCLE = "STEP", "LANDMARK_C"
_STEP_NUMBERS, _CIRCLE_NUMBERS = 9, 6  # numbers in a line, after its words; those of a circle precede its identities
_AT_REST = 1e-6  # [m], [rad] least σ of a motion
_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # from the file's frame to R


def dlr(folder: str | Path) -> Recording:
    """Read the whole log from the published file in `folder`: one step per image, taken as one second without stamps.

    Circles labelled −1 are spurious; circles without an identity, or with several, are UNLABELLED. There is no ground
    truth of robot or circles. Raises FileNotFoundError, or RecordingError that names file and line.
    """
    path = published_file(Path(folder), FILE, SOURCE)
    with naming(path):
        motions, circles, sources, counts = _lines(content_of(path).decode("ascii", errors="replace"))
        points = circles[:, :2] @ _TURN[:2, :2].T
        return Recording(
            name="dlr",
            source=SOURCE,
            terms=TERMS,
            times=np.arange(len(motions), dtype=np.float64),
            motions=motions[:, :3] @ _TURN.T,
            motion_covariances=_turned(motions[:, 3:][:, [0, 1, 3, 1, 2, 4, 3, 4, 5]], 3) + _AT_REST**2 * np.eye(3),
            starts=starts_of(counts),
            points=points,
            covariances=_turned(circles[:, 3:][:, [0, 1, 1, 2]], 2),
            sources=np.array(sources, np.int64),
            range=_RANGE,
            field_of_view=_FIELD_OF_VIEW,
        )


def _lines(text: str) -> tuple[Array, Array, list[int], list[int]]:
    """Numbers of the steps (T, 9) and of the circles (M, 6), identities of the circles, and their count per step."""
    motions: list[list[float]] = []
    circles: list[list[float]] = []
    sources: list[int] = []
    counts: list[int] = []
    for number, line in enumerate(text.splitlines(), 1):
        kind, *words = line.split() or ["#"]
        if kind.startswith("#"):
            continue
        with naming(f"line {number}"):
            if kind == _STEP:
                motions.append(_numbers(words[1:], _STEP_NUMBERS))
                counts.append(0)
                continue
            if kind != _CIRCLE:
                raise ValueError(f"{kind!r} is neither {_STEP} nor {_CIRCLE}")
            if not counts:
                raise ValueError("a circle before the first step")
            circles.append(_numbers(words[:_CIRCLE_NUMBERS], _CIRCLE_NUMBERS))
            sources.append(_identity(words[_CIRCLE_NUMBERS:]))
            counts[-1] += 1
    if not motions:
        raise RecordingError("there is no step")
    return np.array(motions), np.array(circles).reshape(-1, _CIRCLE_NUMBERS), sources, counts


def _numbers(words: list[str], count: int) -> list[float]:
    """Parse `count` finite numbers. Raises ValueError for others."""
    numbers = [float(word) for word in words]
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ValueError(f"expected {count} finite numbers, found {' '.join(words)!r}")
    return numbers


def _identity(words: list[str]) -> int:
    """The identity of a circle: a number, SPURIOUS, or UNLABELLED where none or several are given."""
    identities = [int(word) for word in words]
    if len(identities) != 1:
        return UNLABELLED
    if not SPURIOUS <= identities[0] < 1 << 53:
        raise ValueError(f"identity {identities[0]}")
    return identities[0]


def _turned(entries: Array, side: int) -> Array:
    """Covariances (k, side, side) in R from the entries (k, side²) of covariances in the file's frame."""
    turn = _TURN[:side, :side]
    return np.asarray(turn @ entries.reshape(-1, side, side) @ turn.T)
