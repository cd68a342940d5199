"""The robot's differential drive: what its wheels push, and how it moves by their turning."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pymunk

from slam_gym.validation import check_settings

GRAVITY = 9.81  # [m/s²]


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


class Wheels:
    """The wheels of `body`, at rest, in a simulation with substeps of `step` [s]."""

    def __init__(self, robot: RobotSpec, body: pymunk.Body, step: float) -> None:
        self._robot, self._body, self._moment, self._step = robot, body, body.moment, step
        self.speed, self.turning = 0.0, 0.0  # [m/s, rad/s] of the robot, if the wheels do not slip
        self.odometry = (0.0, 0.0, 0.0)  # [m, m, rad] pose by the turning of the wheels, in R where it was last reset

    def push(self, forward: float, turn: float) -> None:
        """Apply the force and torque that push the robot towards the wheels' next speeds, limited by traction.

        `forward` and `turn` are the commanded fractions in [−1, 1] of the full speeds. The push takes effect at the end
        of the substep, so it is aimed along the chord of the arc that the robot will drive in the next substep. The
        wheels get the speeds that the push would give the robot if nothing pushed back.
        """
        robot, body, moment, step = self._robot, self._body, self._moment, self._step
        self._roll()
        gain, angular_gain = robot.max_acceleration * step, robot.max_angular_acceleration * step
        speed = self.speed + min(max(robot.max_speed * forward - self.speed, -gain), gain)
        spin = self.turning + min(max(robot.max_turn * turn - self.turning, -angular_gain), angular_gain)
        turning = body.angular_velocity
        grip = robot.traction * GRAVITY * step  # [m/s] largest change of speed that traction allows in a substep
        limit = grip * robot.mass * robot.radius / moment
        spin = turning + min(max(spin - turning, -limit), limit)
        aim = body.angle + turning * step + 0.5 * spin * step
        c, s = math.cos(aim), math.sin(aim)
        vx, vy = body.velocity
        dx, dy = speed * c - vx, speed * s - vy
        needed = math.hypot(dx, dy)
        if needed > grip:
            dx, dy = dx * grip / needed, dy * grip / needed
            speed = (vx + dx) * c + (vy + dy) * s
        self.speed, self.turning = speed, spin
        body.force = robot.mass * dx / step, robot.mass * dy / step
        body.torque = moment * (spin - turning) / step

    def _roll(self) -> None:
        """Advance the odometry by one substep: along the chord of an arc."""
        x, y, heading = self.odometry
        distance, angle = self.speed * self._step, self.turning * self._step
        chord = heading + 0.5 * angle
        self.odometry = x + distance * math.cos(chord), y + distance * math.sin(chord), heading + angle
