"""The data that flows through slam_gym: frozen, with shape, unit and frame beside every field.

Frames: **W** world (truth side only), **B** base of the map (the robot's first pose), **R** robot (x forward, y left).
A pose is an array (3,) `[x m, y m, θ rad]`, its heading wrapped to (−π, π].
"""

from __future__ import annotations

from slam_gym.types._fields import UNKNOWN_KIND, Array, BoolArray, IntArray
from slam_gym.types.decided import (
    NO_ID,
    UNPAIRED,
    Effort,
    Experience,
    Hypothesis,
    Posterior,
    Relocation,
    Relocator,
)
from slam_gym.types.mapped import Landmarks, Locality
from slam_gym.types.measured import SPURIOUS, UNLABELLED, Beams, Odometry, Scan, ScanArrays, Truth

__all__ = [
    "NO_ID",
    "SPURIOUS",
    "UNKNOWN_KIND",
    "UNLABELLED",
    "UNPAIRED",
    "Array",
    "Beams",
    "BoolArray",
    "Effort",
    "Experience",
    "Hypothesis",
    "IntArray",
    "Landmarks",
    "Locality",
    "Odometry",
    "Posterior",
    "Relocation",
    "Relocator",
    "Scan",
    "ScanArrays",
    "Truth",
]
