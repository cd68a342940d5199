"""The episode behind every environment: the true world, the robot's estimate of it, and the tick that advances both.

Truth and estimate meet here and nowhere else: the estimate side receives `Odometry`, `Scan` and `Beams`, and works in
B, the frame of the robot's first pose.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from slam_gym.association.prediction import Associator, Prediction
from slam_gym.geometry import compose, compose_jacobians, observe, relative, transform
from slam_gym.metrics import map_quality
from slam_gym.metrics.consistency import pose_nees
from slam_gym.metrics.point_assignment import indexed
from slam_gym.navigation.active_slam import VirtualMap
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.navigation.keyframes import Keyframes
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.navigation.wall_compass import WallCompass
from slam_gym.scenarios import Scenario
from slam_gym.simulation.goals import Places, Tried
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.simulation.kidnapping import Kidnapping
from slam_gym.slam.atlas import AtlasSpec
from slam_gym.slam.relocate import Relocate
from slam_gym.slam.slam import Slam
from slam_gym.types import Array, BoolArray, Hypothesis
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.physics import Motion, World
from slam_gym.world.ray_casting import Packed, wall_index
from slam_gym.world.reachability import free_cells, free_start, observable, reachable
from slam_gym.world.sensor import Sensor

_GRID_MARGIN = 2.0  # [m] of explored grid around the plan, for estimates that drift out of it
_AT_REST = Motion(moved=np.zeros(3), wheels=np.zeros(3), contact=False)


@dataclass(frozen=True, eq=False)
class Site:
    """A floor plan with its wall index, the cells that the robot can reach, and the features that it can see there."""

    plan: FloorPlan
    index: Packed  # of its walls
    cells: Array  # (c, 2) [m] centres of the reachable cells, in W
    observable: BoolArray  # (N,) whether each feature can be seen from one of these cells


def survey(plan: FloorPlan, scenario: Scenario) -> Site:
    """Compute the reachable cells and observable features of a plan. Raises ValueError if there are none of either."""
    index = wall_index(plan.walls)
    cells = reachable(plan, free_cells(plan, scenario.robot.radius))
    if len(cells) == 0:
        what = f"no free space for a robot of radius {scenario.robot.radius} m inside closed outer walls"
        raise ValueError(f"floor plan {plan.name!r}: {what}")
    if len(plan.features) == 0:
        raise ValueError(f"floor plan {plan.name!r}: has no features, so there is nothing to map")
    seen = observable(plan, index, cells, scenario.sensor.range)
    if not seen.any():
        where = "can be seen from the cells that the robot can reach"
        raise ValueError(f"floor plan {plan.name!r}: none of its {len(seen)} features {where}")
    return Site(plan, index, cells, seen)


class Episode:
    """The state of one episode, which `tick` advances.

    `associator` is a name, `"module:function"` or a callable. `virtual` maintains the virtual map, which only the
    uncertainty rewards need. Without `relocate`, a kidnapped robot is never relocated; with `atlas` in addition, loops
    are closed and a lost robot starts another map.
    """

    def __init__(
        self,
        scenario: Scenario,
        site: Site,
        associator: str | Associator,
        rng: np.random.Generator,
        *,
        locality: bool = True,
        virtual: bool = False,
        relocate: Relocate | None = None,
        atlas: AtlasSpec | None = None,
    ) -> None:
        self.scenario, self.site, self.rng = scenario, site, rng
        self.base = free_start(site.plan, site.cells, scenario.robot.radius, rng)  # (3,) pose of B in W
        self.world = World(site.plan, self.base, scenario.robot, scenario.dynamics, rng)
        self.sensor = Sensor(site.plan, site.index, scenario.sensor, scenario.beams, scenario.odometry)
        slam, sensor = scenario.slam, scenario.sensor
        reach = sensor.range if slam.reach is None else slam.reach
        spec = replace(slam, reach=reach, locality=locality and slam.locality)
        x0, y0, x1, y1 = site.plan.bounds
        corners = observe(self.base, np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))  # in B
        bounds = np.concatenate([corners.min(axis=0) - _GRID_MARGIN, corners.max(axis=0) + _GRID_MARGIN])
        self.grid = ExploredGrid(bounds, scenario.grid_resolution)
        sight = ViewsFrom(sensor.field_of_view, sensor.range, sensor.min_range, explored=self.grid.explored)
        self.slam = Slam(spec, sight, relocate=relocate, atlas=atlas)
        # true associations include new features: with a wide gate it would map fewer features than other associators
        self._judged = JudgedSlam(self.slam, associator, informed=True)
        self.identities = self._judged.identities
        self.kidnapping = Kidnapping(scenario.kidnapping, scenario.budget)
        self._keyframes = Keyframes(self.grid)
        self._compass = WallCompass(scenario.beams.sigma) if scenario.wall_compass else None
        # over the bounds of the plan, so in W: its criteria do not depend on the start of the robot
        self.virtual_map = VirtualMap(site.plan.bounds, 1.0, scenario.prior_sigma) if virtual else None
        self.targets = site.plan.features.positions[site.observable]  # (N, 2) [m] observable true features, in W
        in_base, grid = observe(self.base, site.cells), self.grid
        self._reachable = map_quality.cells_of(in_base, grid.cells.shape, grid.origin, grid.resolution)
        self._indexed = indexed(self.targets, 2.0 * scenario.prior_sigma)
        self.poses: list[Array] = []  # (3,) true poses in W, one per tick
        self.estimates: list[Array] = []  # (3,) estimated poses in B, one per tick
        self.nees: list[float] = []  # of the pose; NaN in a second map, whose pose in B is not estimated
        self.path = np.empty((0, 2))  # (p, 2) in B, the path that the driver follows now
        self.places = Places()  # where the robot has been; ExploreEnv adds the start after the first decision
        self.tried = Tried()  # frontiers that were driven to and are still frontiers
        self.ticks = -1  # the first scan, at the start, does not count as a tick
        self._appraised, self._appraised_at = (1.0, 0.0), -1  # map error and coverage, and their tick
        prediction = self._sense(_AT_REST)
        self.end_tick(prediction, self._judged.associate(self.scan, prediction, self.truth))

    def tick(self, forward: float, turn: float) -> None:
        """Drive for one tick with fractions in [−1, 1] of the maximal speeds, take a scan, and run a SLAM step."""
        prediction = self.begin_tick(forward, turn)
        self.end_tick(prediction, self._judged.associate(self.scan, prediction, self.truth))

    def begin_tick(self, forward: float, turn: float) -> Prediction:
        """The first half of a tick: drive, take a scan, and predict it."""
        motion = self.world.tick(forward, turn)
        free = self.site.cells, self.scenario.robot.radius, self.world.furniture
        carried_to = self.kidnapping.destination(self.ticks + 1, self.poses, free, self.rng)
        if carried_to is not None:
            self.world.place(carried_to)
        return self._sense(motion)

    def end_tick(self, prediction: Prediction, hypothesis: Hypothesis) -> None:
        """The second half: complete the SLAM step with a `hypothesis` on the scan, and explore."""
        self.last_step = self._judged.learn(self.scan, prediction, hypothesis, self.truth)
        if not self.slam.doubted:  # a wrong pose would draw walls where there are none
            self._explore()
        self._log()

    def _sense(self, motion: Motion) -> Prediction:
        world, sensor, rng = self.world, self.sensor, self.rng
        moving = world.people, world.furniture_segments
        self.odometry = sensor.odometry(motion, rng)
        self.scan, self.truth = sensor.scan(world.pose, rng, moving)
        self.beams = sensor.beams(world.pose, rng, moving)
        if self._compass is not None:
            self.odometry = self._compass.corrected(self.odometry, self.beams)
        return self.slam.predict(self.odometry, self.scan)

    def _explore(self) -> None:
        """Enter the beams at the estimated pose; redraw what has moved."""
        slam_map, beams = self.slam.map, self.beams
        pose = slam_map.pose
        self._keyframes.enter(pose, self.odometry.motion, beams, self.last_step.ids, slam_map, self.slam.fused)
        if self.virtual_map is not None and len(self.slam.maps) == 1:  # the pose of a second map in B is not estimated
            _, turn = compose_jacobians(self.base, pose)
            covariance = turn @ slam_map.pose_covariance @ turn.T  # in W
            sigma = self.scenario.sensor.sigma_halfway
            self.virtual_map.observe(compose(self.base, pose), covariance, beams, sigma)

    def _log(self) -> None:
        """Record the estimated pose and its error."""
        slam, estimate, true_pose = self.slam, self.slam.map.pose, self.truth.pose
        nees = pose_nees(estimate, slam.map.pose_covariance, relative(self.base, true_pose))
        self.estimates.append(estimate)
        self.nees.append(nees if math.isfinite(nees) and len(slam.maps) == 1 else math.nan)
        self.ticks += 1
        if self.ticks:
            self.places.pass_by(estimate[:2])
        self.poses.append(true_pose)
        if slam.relocations or self.kidnapping.happened is not None:
            in_world = compose(self.base, estimate)
            self.kidnapping.judge(self.ticks, in_world, true_pose, slam.relocations, slam.lost)

    @property
    def over(self) -> bool:
        """Whether the budget is spent."""
        return self.ticks >= self.scenario.budget

    @property
    def landmarks(self) -> Array:
        """(e, 2) [m] confirmed features of the active map in W, then those of inactive maps."""
        return transform(self.base, np.concatenate([m.confirmed for m in self.slam.maps]))

    def map_error(self) -> float:
        """E: 1 for an empty map, 0 for a perfect one (see `metrics.map_quality.map_error`)."""
        return self._appraise()[0]

    def coverage(self) -> float:
        """Fraction of the reachable cells whose true position is known (free or wall) in the explored grid."""
        return self._appraise()[1]

    def _appraise(self) -> tuple[float, float]:
        """Map error and coverage, computed once per tick, since both rewards and info use them."""
        if self._appraised_at != self.ticks:
            error = map_quality.error_of(self.landmarks, self._indexed)
            self._appraised = error, map_quality.coverage(self.grid.cells, self._reachable)
            self._appraised_at = self.ticks
        return self._appraised
