"""Line of sight on a small and on a large floor of equal density, and what the world costs per tick.

Both floors are square rooms of 5 m with a door of .9 m to each neighbour: 5 × 5 of them have 100 wall segments,
50 × 25 have 5 000.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from slam_gym.types import Array
from slam_gym.world.floor_plan import Features, FloorPlan, Kind
from slam_gym.world.generators import OfficeGenerator
from slam_gym.world.physics import DynamicsSpec, RobotSpec, World
from slam_gym.world.ray_casting import WallIndex
from slam_gym.world.reachability import free_start, reachable
from slam_gym.world.sensor import Sensor

ROOM = 5.0  # [m]
DOOR = 0.9  # [m]
PLACES = 200  # robot poses that every figure is taken at
BEAMS = 40
RANGE = 6.0  # [m]

Call = Callable[[int], object]
"""Does its work at place i."""


def floor(rows: int, columns: int) -> FloorPlan:
    """`rows` × `columns` equal rooms; the features are their door jambs."""
    walls: list[tuple[float, float, float, float]] = []
    near, far = 0.5 * (ROOM - DOOR), 0.5 * (ROOM + DOOR)
    for transposed, across, along in ((False, rows, columns), (True, columns, rows)):
        for i in range(across + 1):
            for k in range(along):
                pieces = ((0.0, ROOM),) if i in (0, across) else ((0.0, near), (far, ROOM))
                for a, b in pieces:
                    x1, x2, y = k * ROOM + a, k * ROOM + b, i * ROOM
                    walls.append((y, x1, y, x2) if transposed else (x1, y, x2, y))
    ends = np.array(walls).reshape(-1, 2)
    jambs = ends[(np.abs(ends % ROOM - near) < 1e-6).any(axis=1) | (np.abs(ends % ROOM - far) < 1e-6).any(axis=1)]
    features = Features(jambs, np.full(len(jambs), Kind.DOOR_JAMB), np.full(len(jambs), DOOR))
    return FloorPlan(f"{rows} × {columns} rooms", np.array(walls), features)


def interior_poses(rows: int, columns: int, rng: np.random.Generator) -> Array:
    """Poses (PLACES, 3) in rooms that have neighbours all around, .3 m or more from their walls."""
    rooms = np.column_stack([rng.integers(1, columns - 1, PLACES), rng.integers(1, rows - 1, PLACES)])
    within = rng.uniform(0.3, ROOM - 0.3, (PLACES, 2))
    return np.column_stack([rooms * ROOM + within, rng.uniform(-np.pi, np.pi, PLACES)])


def medians(timed: dict[str, Call], calls: int, repeats: int) -> dict[str, float]:
    """Median time [µs] of call(0), …, call(calls − 1), `repeats` times over, in turns with the other calls."""
    times = {name: np.empty((repeats + 1, calls)) for name in timed}
    for repeat in range(repeats + 1):
        for i in range(calls):
            for name, call in timed.items():
                start = time.perf_counter()
                call(i)
                times[name][repeat, i] = time.perf_counter() - start
    return {name: 1e6 * float(np.median(t[1:])) for name, t in times.items()}  # the first round compiles


def sight_calls(plan: FloorPlan, poses: Array, rng: np.random.Generator) -> dict[str, Call]:
    """Beams, lines of sight to the features in range, and whole scans and sweeps, from each of `poses` (q, 3)."""
    index, angles = WallIndex(plan.walls), np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
    sensor, positions = Sensor(plan, index), plan.features.positions
    targets = [positions[np.hypot(*(positions - pose[:2]).T) < RANGE] for pose in poses]
    seen = float(np.mean([len(near) for near in targets]))
    print(f"{len(plan.walls):5d} segments, {len(positions):5d} features, {seen:.0f} of them in range")
    short = np.full(len(positions), 1e-3)
    return {
        f"{BEAMS} beams": lambda i: index.cast(poses[i], angles, RANGE),
        "features in range": lambda i: index.visible(poses[i], targets[i], short[: len(targets[i])]),
        "Sensor.scan": lambda i: sensor.scan(poses[i], rng),
        "Sensor.beams": lambda i: sensor.beams(poses[i], rng),
    }


def line_of_sight(repeats: int, rng: np.random.Generator) -> None:
    """Print what seeing costs on the two floors, and the ratio."""
    small = sight_calls(floor(5, 5), interior_poses(5, 5, rng), rng)
    large = sight_calls(floor(25, 50), interior_poses(25, 50, rng), rng)
    timed = {
        f"{name} {size}": call for size, calls in (("small", small), ("large", large)) for name, call in calls.items()
    }
    cost = medians(timed, PLACES, repeats)
    print(f"{'':20s}{'100 segments':>14s}{'5 000 segments':>16s}{'ratio':>8s}   (median µs)")
    for name in small:
        a, b = cost[f"{name} small"], cost[f"{name} large"]
        print(f"{name:20s}{a:14.1f}{b:16.1f}{b / a:8.2f}")


def tick_calls(plan: FloorPlan, people: int, rng: np.random.Generator) -> dict[str, Call]:
    """One tick of physics under random actions, and each sense after it."""
    start = free_start(plan, reachable(plan, 0.2), rng)
    world = World(plan, start, RobotSpec(), DynamicsSpec(people=people), rng)
    sensor = Sensor(plan, WallIndex(plan.walls))
    actions, motion = rng.uniform([0.0, -1.0], 1.0, (PLACES, 2)).tolist(), world.tick(1.0, 0.0)
    return {
        "World.tick": lambda i: world.tick(*actions[i]),
        "Sensor.scan": lambda i: sensor.scan(world.pose, rng, world.people, world.furniture_segments),
        "Sensor.beams": lambda i: sensor.beams(world.pose, rng, world.people, world.furniture_segments),
        "Sensor.odometry": lambda i: sensor.odometry(motion, rng),
    }


def per_tick(repeats: int, rng: np.random.Generator) -> None:
    """Print what physics and senses cost per tick in an office, without and with people."""
    plan = OfficeGenerator()(rng)
    boxes = f"{len(plan.furniture)} pieces of furniture"
    print(f"\noffice: {len(plan.walls)} segments, {len(plan.features)} features, {boxes}")
    for people in (0, 6):
        cost = medians(tick_calls(plan, people, rng), PLACES, repeats)
        print(
            f"{people} people: " + ", ".join(f"{name} {value:.1f}" for name, value in cost.items()) + "   (median µs)"
        )


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="slam_gym.bench sight", description=__doc__.split("\n", 1)[0])
    parser.add_argument("--repeats", type=int, default=21)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    rng = np.random.default_rng(options.seed)
    line_of_sight(options.repeats, rng)
    per_tick(options.repeats, rng)


if __name__ == "__main__":
    main()
