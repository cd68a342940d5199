"""The physical world in pymunk: static walls, a differential-drive robot, furniture that it can push, people.

The world is seen from above and has no gravity; friction on the floor is a joint to the ground with a bounded force.
Every episode builds a new world, since a pymunk space whose bodies are put back diverges from a fresh one. The same
plan, start, generator state and actions give the same trajectory, bit for bit.
"""

import math
from dataclasses import dataclass

import numpy as np
import pymunk

from slam_gym.geometry import relative, wrap_angle
from slam_gym.types import Array
from slam_gym.validation import Checked
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.people import People
from slam_gym.world.ray_casting import outlines

_GRAVITY = 9.81  # [m/s²]
_OVERLAP = 1e-3  # [m] overlap that touching bodies keep, so that contacts last
_OVERLAP_LEFT = 0.5  # fraction of any further overlap that is left after a substep
_LEVER = 0.38  # mean distance from the centre of a square of side 1 to its points
_ROBOT, _PERSON, _FURNITURE = 1, 2, 4  # categories of the shape filter


@dataclass(frozen=True)
class RobotSpec(Checked):
    """A disc on two driven wheels."""

    radius: float = 0.2  # [m]
    mass: float = 10.0  # [kg]
    max_speed: float = 1.0  # [m/s]
    max_turn: float = 2.0  # [rad/s]
    max_acceleration: float = 3.0  # [m/s²] of the wheels
    max_angular_acceleration: float = 10.0  # [rad/s²]
    traction: float = 0.6  # the wheels push with at most traction · mass · g


@dataclass(frozen=True)
class DynamicsSpec(Checked):
    """Time steps, friction, furniture and people."""

    tick: float = 0.1  # [s]
    substeps: int = 2  # physics steps in a tick
    friction: float = 0.3  # coefficient between bodies that touch
    furniture_density: float = 15.0  # [kg/m²] mass per floor area that it covers
    furniture_friction: float = 0.25  # coefficient on the floor
    people: int = 0
    person_radius: float = 0.25  # [m]
    person_speed: float = 0.8  # [m/s]


@dataclass(frozen=True, slots=True)
class Motion:
    """The robot's motion in one tick."""

    moved: Array  # (3,) [m, m, rad] pose at the end of the tick, in R at the tick's start
    wheels: Array  # (3,) [m, m, rad] the same by the turning of the wheels; it differs where they slipped
    contact: bool  # the robot touched something, or its wheels lost their grip, during the tick


class _Wheels:
    """The wheels of `body`, at rest, in a simulation with substeps of `step` [s]."""

    def __init__(self, robot: RobotSpec, body: pymunk.Body, step: float) -> None:
        self._robot, self._body, self._moment, self._step = robot, body, body.moment, step
        self.speed, self.turning = 0.0, 0.0  # [m/s, rad/s] of the robot, if the wheels do not slip
        self.odometry = (0.0, 0.0, 0.0)  # [m, m, rad] motion by the wheels since the last reset, in R at that time
        self.slipped = False  # since then

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
        grip = robot.traction * _GRAVITY * step  # [m/s] largest change of speed that traction allows in a substep
        limit = grip * robot.mass * robot.radius / moment
        spin = turning + min(max(spin - turning, -limit), limit)
        aim = body.angle + turning * step + 0.5 * spin * step
        c, s = math.cos(aim), math.sin(aim)
        vx, vy = body.velocity
        dx, dy = speed * c - vx, speed * s - vy
        needed = math.hypot(dx, dy)
        if needed > grip:
            self.slipped = True
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


class World:
    """A physical world of `plan` with the robot at `start` (3,) W; `rng` draws where people stand and walk.

    Raises ValueError where `start` is not finite or the plan has no room for so many people.
    """

    def __init__(
        self, plan: FloorPlan, start: Array, robot: RobotSpec, dynamics: DynamicsSpec, rng: np.random.Generator
    ) -> None:
        if np.shape(start) != (3,) or not np.isfinite(start).all():
            raise ValueError(f"start must be a finite pose (3,), not {start}")
        self.robot, self.dynamics, self._rng = robot, dynamics, rng
        self._step = dynamics.tick / dynamics.substeps
        self._space = _empty_space(self._step)
        self._add_walls(plan.walls)
        self.furniture = plan.furniture.copy()  # (f, 5) [m, m, m, m, rad] x y length width heading, W
        self.furniture_segments = outlines(self.furniture)  # (4f, 4) [m] W its sides
        self._pieces = [self._add_furniture(box) for box in self.furniture]
        self._body = self._add_robot(start)
        self._wheels = _Wheels(robot, self._body, self._step)
        self._update_pose()
        gap = robot.radius + robot.max_speed * dynamics.tick + 0.05
        self._people = People(plan, dynamics.people, dynamics.person_radius, dynamics.person_speed, gap, start[:2], rng)
        self._walkers = [self._add_person(disc) for disc in self._people.discs]

    @property
    def people(self) -> Array:
        """(p, 3) [m] `x y radius` W, a copy."""
        return self._people.discs.copy()

    def tick(self, forward: float, turn: float) -> Motion:
        """Drive for one tick at these fractions of the full speeds, clipped to [−1, 1]. Raises ValueError for NaN."""
        if not (-1.0 <= forward <= 1.0 and -1.0 <= turn <= 1.0):
            if math.isnan(forward) or math.isnan(turn):
                raise ValueError(f"action ({forward}, {turn}) is not a number")
            forward, turn = min(max(forward, -1.0), 1.0), min(max(turn, -1.0), 1.0)
        before, wheels, contact = self.pose, self._wheels, self._touches()
        wheels.odometry, wheels.slipped = (0.0, 0.0, 0.0), False
        self._people.walk(self.dynamics.tick, before[:2], self.furniture, self._rng)
        for walker, (vx, vy) in zip(self._walkers, self._people.velocities.tolist()):
            walker.velocity = (vx, vy)
        for _ in range(self.dynamics.substeps):
            wheels.push(forward, turn)
            self._space.step(self._step)
            contact = contact or self._touches()
        self._update_pose()
        if not all(piece.is_sleeping for piece in self._pieces):
            self._follow_furniture()
        return Motion(relative(before, self.pose), np.array(wheels.odometry), contact or wheels.slipped)

    def _touches(self) -> bool:
        """Whether something touches the robot now."""
        touching: list[pymunk.Arbiter] = []
        self._body.each_arbiter(touching.append)
        return bool(touching)

    def _update_pose(self) -> None:
        x, y = self._body.position
        self.pose = np.array([x, y, wrap_angle(self._body.angle)])  # (3,) [m, m, rad] W

    def place(self, pose: Array) -> None:
        """Put the robot at `pose` (3,) W, at rest. Raises ValueError where `pose` is not finite."""
        if np.shape(pose) != (3,) or not np.isfinite(pose).all():
            raise ValueError(f"pose must be a finite pose (3,), not {pose}")
        body, (x, y, heading) = self._body, pose.tolist()
        body.position, body.angle, body.velocity, body.angular_velocity = (x, y), heading, (0.0, 0.0), 0.0
        self._space.reindex_shapes_for_body(body)
        self._wheels = _Wheels(self.robot, body, self._step)
        self._update_pose()

    def _follow_furniture(self) -> None:
        """Read the poses of the furniture that moves. Arrays returned earlier stay unchanged."""
        furniture = self.furniture.copy()
        for row, body in zip(furniture, self._pieces):
            if not body.is_sleeping:
                row[0], row[1] = body.position
                row[4] = body.angle
        self.furniture, self.furniture_segments = furniture, outlines(furniture)

    def _add_walls(self, walls: Array) -> None:
        ground = self._space.static_body
        segments = [pymunk.Segment(ground, (x1, y1), (x2, y2), 0.0) for x1, y1, x2, y2 in walls.tolist()]
        for segment in segments:
            segment.friction = self.dynamics.friction
        self._space.add(*segments)

    def _add_robot(self, start: Array) -> pymunk.Body:
        mass, radius = self.robot.mass, self.robot.radius
        body = pymunk.Body(mass, pymunk.moment_for_circle(mass, 0.0, radius))
        body.position, body.angle = (float(start[0]), float(start[1])), float(start[2])
        return self._add(body, pymunk.Circle(body, radius), _ROBOT, pymunk.ShapeFilter.ALL_MASKS())

    def _add_person(self, disc: Array) -> pymunk.Body:
        body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        body.position = (float(disc[0]), float(disc[1]))
        return self._add(body, pymunk.Circle(body, float(disc[2])), _PERSON, _ROBOT)

    def _add_furniture(self, box: Array) -> pymunk.Body:
        """A box with friction on the floor: joints to the ground hold it with the force and torque of friction."""
        x, y, length, width, heading = box.tolist()
        mass = self.dynamics.furniture_density * length * width
        body = pymunk.Body(mass, pymunk.moment_for_box(mass, (length, width)))
        body.position, body.angle = (x, y), heading
        others = pymunk.ShapeFilter.ALL_MASKS() ^ _PERSON
        self._add(body, pymunk.Poly.create_box(body, (length, width)), _FURNITURE, others)
        ground = self._space.static_body
        slide, twist = pymunk.PivotJoint(ground, body, (x, y)), pymunk.GearJoint(ground, body, heading, 1.0)
        slide.max_force = self.dynamics.furniture_friction * mass * _GRAVITY
        twist.max_force = slide.max_force * _LEVER * math.sqrt(length * width)
        for joint in (slide, twist):
            joint.max_bias = 0.0  # hold against motion, do not pull back
            self._space.add(joint)
        body.sleep()
        return body

    def _add(self, body: pymunk.Body, shape: pymunk.Shape, kind: int, collides_with: int) -> pymunk.Body:
        shape.friction = self.dynamics.friction
        shape.filter = pymunk.ShapeFilter(categories=kind, mask=collides_with)
        self._space.add(body, shape)
        return body


def _empty_space(step: float) -> pymunk.Space:
    """A space in SI units: pymunk's defaults suit pixels."""
    space = pymunk.Space()
    space.collision_slop = _OVERLAP
    space.collision_bias = _OVERLAP_LEFT ** (1.0 / step)
    space.idle_speed_threshold = 0.01  # [m/s]
    space.sleep_time_threshold = 0.3  # [s]
    return space
