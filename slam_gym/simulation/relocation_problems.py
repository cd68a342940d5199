"""Relocation problems: a map that a robot has made by SLAM, and scans from inside and from outside of it."""

import math
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from slam_gym.association.prediction import Associator
from slam_gym.geometry import compose, relative
from slam_gym.metrics.map_quality import align_se2
from slam_gym.scenarios import SPLITS, Scenario, world_generator, world_seed
from slam_gym.simulation.association_runs import drive, nearest_frontier
from slam_gym.simulation.driver import commands
from slam_gym.simulation.episode import Episode, survey
from slam_gym.simulation.goals import LOOK
from slam_gym.slam.relocate import LocalityName, locality_of
from slam_gym.types import SPURIOUS, UNPAIRED, Array, IntArray, Locality, Scan
from slam_gym.world.physics import World
from slam_gym.world.reachability import free_start
from slam_gym.world.sensor import Sensor

KNOWN = 5  # least number of measurements of mapped features in a scan from inside
_DRAWS = 100  # places tried for such a scan


class MappedWorld:
    """A world, the map that SLAM has made of it, and the truth: everything that `kidnap` draws problems from.

    A robot has explored the world, by nearest frontiers and then revisits, until the budget of the scenario was spent.
    Nobody carried it away while it mapped: no search would have relocated it. Scans from outside come from the next
    world of `elsewhere` (default: of the scenario itself).

    The result depends on the arguments only. Raises ValueError for a world outside the split, and as `survey` does.
    """

    def __init__(
        self,
        scenario: Scenario,
        split: str,
        world: int,
        associator: str | Associator,
        elsewhere: Scenario | None = None,
    ) -> None:
        rng = np.random.default_rng((world_seed(split, world), 2))
        self.site = survey(scenario.generator(world_generator(split, world)), scenario)
        episode = Episode(replace(scenario, kidnapping=None), self.site, associator, rng)
        for forward, turn in chain(commands(episode, LOOK, np.zeros(2)), drive(episode, nearest_frontier, episode.rng)):
            episode.tick(forward, turn)
        self.base = episode.base  # (3,) pose of B in W
        self.landmarks, self.graph = episode.slam.map.landmarks(), episode.slam.covisibility
        sources = episode.identities.source_of(episode.slam.map.ids)
        oldest = np.isin(np.arange(len(sources)), np.unique(sources, return_index=True)[1])
        # (n,) true feature behind each landmark; SPURIOUS: none, or the landmark is a duplicate of an older one
        self.identities: IntArray = np.where(oldest & (sources >= 0), sources, SPURIOUS)
        self.trail = np.array(episode.poses)  # (t, 3) true poses of the robot that made the map, in W
        self.moving = episode.world.people, episode.world.furniture_segments  # at the end of mapping
        self.sensor = episode.sensor
        elsewhere = elsewhere or scenario
        other = elsewhere.generator(world_generator(split, (world + 1) % SPLITS[split][1]))
        plan = self.site.plan
        is_only_world = np.array_equal(other.walls, plan.walls) and np.array_equal(
            other.features.positions, plan.features.positions
        )
        self.elsewhere = None if is_only_world else survey(other, elsewhere)  # another world

    def locality(self, kind: LocalityName | None) -> Locality | None:
        """The locality of the landmarks of the given kind."""
        return locality_of(self.graph, self.landmarks.positions, self.sensor.spec.range, kind)


@dataclass(frozen=True, eq=False)
class Kidnapped:
    """A scan from an unknown place, with its truth."""

    scan: Scan
    inside: bool  # whether the place is in the map
    true_pose: Array  # (3,) in W of the world of the scan
    pose: Array  # (3,) in B of the map: the true pose, relative to the landmarks around it; NaN outside
    features: IntArray  # (m,) landmark behind each measurement; UNPAIRED: spurious or not in the map


def kidnap(mapped: MappedWorld, scenario: Scenario, inside: bool, rng: np.random.Generator) -> Kidnapped:
    """A scan from a place where the robot has been, with a random heading, or from another world.

    Inside, at least `KNOWN` measurements are of mapped features; outside, the scan has at least as many measurements.
    Places are drawn until one gives such a scan; after `_DRAWS` places, the best scan is returned.
    """
    best, most = None, -1
    for _ in range(_DRAWS):
        drawn = _inside(mapped, rng) if inside else _outside(mapped, scenario, rng)
        found = int((drawn.features != UNPAIRED).sum()) if inside else len(drawn.scan)
        if found > most:
            best, most = drawn, found
        if most >= KNOWN:
            break
    assert best is not None
    return best


def _inside(mapped: MappedWorld, rng: np.random.Generator) -> Kidnapped:
    place = mapped.trail[rng.integers(len(mapped.trail)), :2]
    true = np.array([place[0], place[1], rng.uniform(-math.pi, math.pi)])
    scan, truth = mapped.sensor.scan(true, rng, mapped.moving)
    landmark = np.full(len(mapped.site.plan.features) + 1, UNPAIRED)  # the last entry is that of SPURIOUS
    known = np.flatnonzero(mapped.identities != SPURIOUS)
    landmark[mapped.identities[known]] = known
    return Kidnapped(scan, True, true, _in_map(mapped, true), landmark[truth.sources])


def _in_map(mapped: MappedWorld, true: Array) -> Array:
    """A true pose (3,) in B, by alignment of the true features in reach with their landmarks: drift is no error. With
    fewer than two of them, the pose relative to the start."""
    positions = mapped.site.plan.features.positions
    known = np.flatnonzero(mapped.identities != SPURIOUS)
    offsets = positions[mapped.identities[known]] - true[:2]
    near = known[np.hypot(offsets[:, 0], offsets[:, 1]) <= mapped.sensor.spec.range]
    if len(near) < 2:
        return relative(mapped.base, true)
    return compose(align_se2(positions[mapped.identities[near]], mapped.landmarks.positions[near]), true)


def _outside(mapped: MappedWorld, scenario: Scenario, rng: np.random.Generator) -> Kidnapped:
    site = mapped.elsewhere
    if site is None:
        raise ValueError(f"outside: the scenario {scenario.name!r} has one world only, and all of it is inside")
    sensor = Sensor(site.plan, site.index, scenario.sensor, scenario.beams, scenario.odometry)
    true = free_start(site.plan, site.cells, scenario.robot.radius, rng)
    world = World(site.plan, true, scenario.robot, scenario.dynamics, rng)
    scan, _ = sensor.scan(true, rng, (world.people, world.furniture_segments))
    return Kidnapped(scan, False, true, np.full(3, np.nan), np.full(len(scan), UNPAIRED))
