"""How the robot drives, compiled: the push of its wheels, and its motion where nothing is within reach.

A robot that touches nothing moves as pymunk would integrate it: in each substep first the position by the velocity,
then the velocity by the push. When it then touches two things at once, what pymunk makes of it depends on which of them
it finds first, and that on where its tree has last entered the robot: at a place where the robot left the box, larger
than itself, of the entry before. The state of the robot therefore has that entry as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slam_gym._jit import compiled
from slam_gym.geometry import relative, wrap_angle
from slam_gym.types import Array
from slam_gym.world.ray_casting import Grid, Packed, box_distance, squared_distance

X, Y, HEADING, VX, VY, TURNING, RIM, SPIN, ENTERED, BOX = *range(9), 12
ENTRIES = 16
"""Entries of the robot's state: x, y [m] and heading [rad, not wrapped] in W; velocities [m/s], [rad/s] of the body;
those [m/s], [rad/s] that the turning of the wheels amounts to; x, y and velocities as its body was last entered in
pymunk's tree; and the box there, xmin, ymin, xmax, ymax [m]."""

_BOX_MARGIN = float(np.float32(0.1))  # of the box's side, and [s] of the velocity, by which the box is larger

GRAVITY = 9.81  # [m/s²]
_NEAR = 1e-3  # [m] from which on a body that comes near may touch: pymunk decides


class Figures(NamedTuple):
    """What the motion depends on."""

    step: float  # [s] of a substep
    substeps: int  # in a tick
    radius: float  # [m]
    mass: float  # [kg]
    moment: float  # [kg m²]
    max_speed: float  # [m/s]
    max_turn: float  # [rad/s]
    max_acceleration: float  # [m/s²] of the wheels
    max_angular_acceleration: float  # [rad/s²]
    traction: float  # the wheels push with at most traction · mass · g


PackedFigures = tuple[float, int, float, float, float, float, float, float, float, float]
"""`Figures` as a plain tuple."""


@compiled
def push(packed: PackedFigures, forward: float, turn: float, state: Array, wheels: Array) -> tuple[float, float, float]:
    """Push the robot towards the wheels' next speeds, as hard as their traction allows: force (x, y) [N] in W, torque
    [N m].

    The push takes effect at the end of the substep, so it is aimed along the chord of the arc that the robot will drive
    in the next one. What it would make of the robot's motion, if nothing pushed back, is what the wheels do: their
    speeds in `state` are those from then on, and `wheels` (3,), the pose in R at the tick's start that they have led to
    so far, goes on by this substep.

    `forward` and `turn` are fractions in [−1, 1] of the full speeds.
    """
    figures = Figures(*packed)
    step = figures.step
    way, turned = state[RIM] * step, state[SPIN] * step
    wheels[0] += way * math.cos(wheels[2] + 0.5 * turned)
    wheels[1] += way * math.sin(wheels[2] + 0.5 * turned)
    wheels[2] += turned
    faster, quicker = figures.max_acceleration * step, figures.max_angular_acceleration * step  # at most
    rim = state[RIM] + min(max(figures.max_speed * forward - state[RIM], -faster), faster)
    spin = state[SPIN] + min(max(figures.max_turn * turn - state[SPIN], -quicker), quicker)
    now = state[TURNING]
    grip = figures.traction * GRAVITY * step  # [m/s] by which the wheels change the speed at most in a substep
    limit = grip * figures.mass * figures.radius / figures.moment
    spin = now + min(max(spin - now, -limit), limit)
    aim = state[HEADING] + now * step + 0.5 * spin * step
    c, s = math.cos(aim), math.sin(aim)
    dx, dy = rim * c - state[VX], rim * s - state[VY]
    needed = math.hypot(dx, dy)
    if needed > grip:
        dx, dy = dx * grip / needed, dy * grip / needed
        rim = (state[VX] + dx) * c + (state[VY] + dy) * s
    state[RIM], state[SPIN] = rim, spin
    return figures.mass * dx / step, figures.mass * dy / step, figures.moment * (spin - now) / step


@compiled
def drive_freely(
    walls: Packed,
    furniture: Array,
    packed: PackedFigures,
    forward: float,
    turn: float,
    state: Array,
    motion: Array,
) -> bool:
    """One tick among resting `furniture` (f, 5) where the robot comes near nothing; False, nothing done, where it does.

    Rows of `motion` (3, 3): the pose at the end, wrapped, the pose before it that is replaced by the motion in R, and
    the same as the wheels tell it.
    """
    figures, grid, after = Figures(*packed), Grid(*walls), state.copy()
    step, reach = figures.step, figures.radius + _NEAR
    wheels = motion[2]
    wheels[:] = 0.0
    for _ in range(figures.substeps):
        x, y, torque = push(packed, forward, turn, after, wheels)
        after[X] += after[VX] * step
        after[Y] += after[VY] * step
        after[HEADING] += after[TURNING] * step
        entered(after, figures.radius)
        if _walls_within(grid, after[X], after[Y], reach) or box_distance(after[X], after[Y], furniture) < reach:
            return False
        after[VX] += x * (1.0 / figures.mass) * step
        after[VY] += y * (1.0 / figures.mass) * step
        after[TURNING] += torque * (1.0 / figures.moment) * step
    state[:] = after
    end_of_tick(state, motion)
    return True


@compiled
def entered(state: Array, radius: float) -> None:
    """Note down whether pymunk's tree enters the robot anew where it is now, with the velocity that has led there."""
    x, y, box = state[X], state[Y], state[BOX:]
    if box[0] <= x - radius and box[1] <= y - radius and x + radius <= box[2] and y + radius <= box[3]:
        return
    margin = ((x + radius) - (x - radius)) * _BOX_MARGIN, ((y + radius) - (y - radius)) * _BOX_MARGIN
    for axis in range(2):
        at, ahead = state[X + axis], state[VX + axis] * _BOX_MARGIN
        state[ENTERED + axis], state[ENTERED + 2 + axis] = at, state[VX + axis]
        box[axis] = at - radius + min(-margin[axis], ahead)
        box[2 + axis] = at + radius + max(margin[axis], ahead)


@compiled
def end_of_tick(state: Array, motion: Array) -> None:
    """Enter the pose of `state`, and the motion since that which `motion` (3, 3) has held so far, in its first rows."""
    before = motion[0].copy()
    motion[0, 0], motion[0, 1], motion[0, 2] = state[X], state[Y], wrap_angle(state[HEADING])
    motion[1] = relative(before, motion[0])


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
