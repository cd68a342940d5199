"""Compiled motion of the robot: the push of its wheels, and whole ticks in which it touches nothing.

A robot that touches nothing is integrated as pymunk does it: each substep first moves the position by the velocity,
then changes the velocity by the push. When the robot later touches two bodies at once, pymunk's result depends on which
body its bounding-box tree finds first, and therefore on when the robot was last entered in that tree. A body is entered
again when it leaves its box in the tree, which is larger than the body. The robot's state includes this last entry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slam_gym._jit import compiled
from slam_gym.types import Array
from slam_gym.types._fields import compiled_form
from slam_gym.validation import check_settings
from slam_gym.world.ray_casting import Grid, Packed, box_distance, squared_distance

X, Y, HEADING, VX, VY, TURNING, WHEEL_SPEED, WHEEL_TURNING, ENTRY, BOX = *range(9), 12
ENTRIES = 16
"""Length of the robot's state: x, y [m] and heading [rad, not wrapped] in W; velocities of the body in W [m/s, m/s,
rad/s]; speed and turning rate of the wheels [m/s, rad/s]; x, y [m] and their velocities [m/s] when the body was last
entered in pymunk's tree; its box there, xmin, ymin, xmax, ymax [m]. The names above are the indices."""

_BOX_MARGIN = float(np.float32(0.1))  # a box in the tree is larger by this fraction of its side, or [s] times velocity

GRAVITY = 9.81  # [m/s²]
_NEAR = 1e-3  # [m] bodies closer than this may touch, so pymunk integrates the tick


@dataclass(frozen=True)
class RobotSpec:
    """A disc on two driven wheels."""

    radius: float = 0.2  # [m]
    mass: float = 10.0  # [kg]
    max_speed: float = 1.0  # [m/s]
    max_turn: float = 2.0  # [rad/s]
    max_acceleration: float = 3.0  # [m/s²] of the wheels
    max_angular_acceleration: float = 10.0  # [rad/s²]
    traction: float = 0.6  # the wheels push with at most traction · mass · g

    def __post_init__(self) -> None:
        check_settings(self)


_Parameters = compiled_form("_Parameters", RobotSpec, "step", "substeps", "moment")
Parameters = tuple[float, ...]
"""Seconds of a substep, substeps in a tick, moment of inertia [kg m²], and the values of a `RobotSpec`: a plain tuple,
which crosses from Python to compiled functions faster."""


@compiled
def push(packed: Parameters, forward: float, turn: float, state: Array, wheels: Array) -> tuple[float, float, float]:
    """Force (x, y) [N] in W and torque [N m] that push the robot towards the wheels' next speeds, limited by traction.

    `forward` and `turn` are the commanded fractions in [−1, 1] of the full speeds. The push takes effect at the end of
    the substep, so it is aimed along the chord of the arc that the robot will drive in the next substep. Updates the
    wheels' speeds in `state` to the speeds that the push would give the robot if nothing pushed back, and advances
    `wheels` (3,), the pose by wheel odometry in R at the tick's start, by this substep.
    """
    parameters = _Parameters(*packed)
    step = parameters.step
    distance, angle = state[WHEEL_SPEED] * step, state[WHEEL_TURNING] * step
    wheels[0] += distance * math.cos(wheels[2] + 0.5 * angle)
    wheels[1] += distance * math.sin(wheels[2] + 0.5 * angle)
    wheels[2] += angle
    max_gain, max_turn_gain = parameters.max_acceleration * step, parameters.max_angular_acceleration * step
    speed = state[WHEEL_SPEED] + min(max(parameters.max_speed * forward - state[WHEEL_SPEED], -max_gain), max_gain)
    turn_error = parameters.max_turn * turn - state[WHEEL_TURNING]
    spin = state[WHEEL_TURNING] + min(max(turn_error, -max_turn_gain), max_turn_gain)
    turning = state[TURNING]
    grip = parameters.traction * GRAVITY * step  # [m/s] largest change of speed that traction allows in a substep
    limit = grip * parameters.mass * parameters.radius / parameters.moment
    spin = turning + min(max(spin - turning, -limit), limit)
    aim = state[HEADING] + turning * step + 0.5 * spin * step
    c, s = math.cos(aim), math.sin(aim)
    dx, dy = speed * c - state[VX], speed * s - state[VY]
    needed = math.hypot(dx, dy)
    if needed > grip:
        dx, dy = dx * grip / needed, dy * grip / needed
        speed = (state[VX] + dx) * c + (state[VY] + dy) * s
    state[WHEEL_SPEED], state[WHEEL_TURNING] = speed, spin
    return parameters.mass * dx / step, parameters.mass * dy / step, parameters.moment * (spin - turning) / step


@compiled
def drive_freely(
    walls: Packed,
    furniture: Array,
    packed: Parameters,
    forward: float,
    turn: float,
    state: Array,
    wheels: Array,
) -> bool:
    """Drive for one tick among resting `furniture` (f, 5); False, and `state` unchanged, if the robot comes near
    anything. `wheels` (3,) becomes the motion in R at the tick's start, by wheel odometry."""
    parameters, grid, after = _Parameters(*packed), Grid(*walls), state.copy()
    step, reach = parameters.step, parameters.radius + _NEAR
    wheels[:] = 0.0
    for _ in range(int(parameters.substeps)):
        x, y, torque = push(packed, forward, turn, after, wheels)
        after[X] += after[VX] * step
        after[Y] += after[VY] * step
        after[HEADING] += after[TURNING] * step
        update_tree_entry(after, parameters.radius)
        if _walls_within(grid, after[X], after[Y], reach) or box_distance(after[X], after[Y], furniture) < reach:
            return False
        after[VX] += x * (1.0 / parameters.mass) * step
        after[VY] += y * (1.0 / parameters.mass) * step
        after[TURNING] += torque * (1.0 / parameters.moment) * step
    state[:] = after
    return True


@compiled
def update_tree_entry(state: Array, radius: float) -> None:
    """Update the last entry in pymunk's tree, as pymunk does, if the robot has left its box there."""
    x, y, box = state[X], state[Y], state[BOX:]
    if box[0] <= x - radius and box[1] <= y - radius and x + radius <= box[2] and y + radius <= box[3]:
        return
    margin = ((x + radius) - (x - radius)) * _BOX_MARGIN, ((y + radius) - (y - radius)) * _BOX_MARGIN
    for axis in range(2):
        centre, ahead = state[X + axis], state[VX + axis] * _BOX_MARGIN
        state[ENTRY + axis], state[ENTRY + 2 + axis] = centre, state[VX + axis]
        box[axis] = centre - radius + min(-margin[axis], ahead)
        box[2 + axis] = centre + radius + max(margin[axis], ahead)


@compiled
def _walls_within(grid: Grid, x: float, y: float, reach: float) -> bool:
    """Whether a wall comes within `reach` [m] of (x, y)."""
    first = max(math.floor((x - reach - grid.xmin) / grid.cell), 0)
    last = min(math.floor((x + reach - grid.xmin) / grid.cell), grid.columns - 1)
    bottom = max(math.floor((y - reach - grid.ymin) / grid.cell), 0)
    top = min(math.floor((y + reach - grid.ymin) / grid.cell), grid.rows - 1)
    for row in range(bottom, top + 1):
        for column in range(first, last + 1):
            cell = row * grid.columns + column
            for k in range(grid.starts[cell], grid.starts[cell + 1]):
                if squared_distance(x, y, grid.walls, grid.members[k]) < reach * reach:
                    return True
    return False
