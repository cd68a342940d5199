"""World and estimate side by side: the books that an episode keeps, and what nobody gets to see of it."""

import gc
from collections.abc import Iterator
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from slam_gym.association import jcbb
from slam_gym.association.prediction import Prediction
from slam_gym.geometry import compose, observe, relative, transform
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.metrics.association import Identities
from slam_gym.metrics.consistency import pose_nees
from slam_gym.metrics.map_quality import map_error
from slam_gym.navigation.explored_grid import UNKNOWN, ExploredGrid
from slam_gym.scenarios import KidnappingSpec, Scenario
from slam_gym.simulation.episode import Episode, Site
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.relocate import relocate_by
from slam_gym.slam.slam import Slam
from slam_gym.types import UNPAIRED, Effort, Hypothesis, Relocation, Scan, Truth
from slam_gym.world.floor_plan import FloorPlan
from slam_gym.world.physics import World
from slam_gym.world.sensor import Sensor
from tests.rollouts import short
from tests.simulation.episodes import SMALL, drive, site_of, start

SECRETS = (
    Episode, Site, FloorPlan, World, Sensor, Truth, Scenario, Identities, JudgedSlam, Slam, StochasticMap,
    CovisibilityGraph, ExploredGrid, np.random.Generator,
)  # fmt: skip


CODE = (type, ModuleType, BuiltinFunctionType, Dispatcher)


def reachable(*roots: object) -> Iterator[object]:
    """All objects behind `roots`: by attributes, in closures and defaults, and whatever the garbage collector knows.

    Types, modules, compiled functions and the globals of functions are code: everybody can import those.
    """
    todo, seen = list(roots), {}
    while todo:
        thing = todo.pop()
        if id(thing) in seen or isinstance(thing, CODE):
            continue
        seen[id(thing)] = thing  # kept alive, so that no other gets its id
        yield thing
        todo += _behind(thing)


def _behind(thing: object) -> list[object]:
    if isinstance(thing, FunctionType):
        cells = [cell.cell_contents for cell in thing.__closure__ or ()]
        return [*cells, thing.__defaults__, thing.__kwdefaults__, thing.__dict__]
    if isinstance(thing, MethodType):
        return [thing.__self__, thing.__func__]
    if isinstance(thing, (np.ndarray, memoryview)):  # which the garbage collector does not know
        return [getattr(thing, "base", None), getattr(thing, "obj", None)]
    return gc.get_referents(thing)


class Spy:
    """An associator that keeps all it can get hold of in its last scan."""

    def __init__(self) -> None:
        self.found: list[object] = []

    def __call__(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        prediction.visibility()
        self.found = list(reachable(scan, prediction))
        return Hypothesis(np.full(len(scan), UNPAIRED), 0.0, 0, Effort())


# --- attacks ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("locality", [True, False])
@pytest.mark.parametrize("relocating", [True, False])
def test_an_associator_finds_no_way_to_the_episode(locality: bool, relocating: bool) -> None:
    """No object that knows or keeps anything is reached from what it is handed."""
    spy = Spy()
    episode = start(associator=spy, locality=locality, relocate=relocate_by("gcbb") if relocating else None)
    drive(episode, 5)
    spied = [type(thing).__name__ for thing in spy.found if isinstance(thing, SECRETS)]
    assert len(spy.found) > 25 and not spied


def test_the_search_for_ways_finds_those_that_there_are() -> None:
    """Else the test above would say nothing: from an episode to all, and through closures and bound methods."""
    episode = start()
    found = list(reachable(episode))
    for secret in (World, Truth, StochasticMap, ExploredGrid, Site, Identities):
        assert any(isinstance(thing, secret) for thing in found), secret
    for way in (lambda: episode.truth, episode.tick, [{"deep": (episode,)}], Spy.__call__.__get__(episode)):
        assert any(thing is episode for thing in reachable(way))


def test_a_relocator_finds_no_way_to_the_episode_and_cannot_write_to_the_scan() -> None:
    found: list[object] = []

    def spy(scan: Scan, landmarks, locality) -> Relocation:
        with pytest.raises(ValueError, match="read-only"):
            scan.points[...] = 0.0
        found.extend(reachable(scan, landmarks, locality))
        nothing = np.full(len(scan), UNPAIRED)
        return Relocation(nothing, np.full(3, np.nan), np.full((3, 3), np.nan), 0.0, 0, 3, False, 0, Effort())

    scenario = short(60, "kidnapped", kidnapping=KidnappingSpec(at=0.4, inside=False))
    drive(start(scenario, relocate=relocate_by(spy)), 60)
    assert len(found) > 10 and not [type(thing) for thing in found if isinstance(thing, SECRETS)]


# --- books ------------------------------------------------------------------------------------------------------------


def test_the_first_look_is_no_tick_and_every_tick_is_written_down() -> None:
    episode = start()
    assert episode.ticks == 0 and len(episode.poses) == len(episode.estimates) == len(episode.nees) == 1
    np.testing.assert_array_equal(episode.poses[0], episode.base)
    np.testing.assert_allclose(episode.estimates[0], np.zeros(3), atol=1e-3)  # the wheels at rest, as they tell it
    assert episode.slam.map.n == len(episode.scan) > 0
    for tick in range(1, 6):
        episode.tick(1.0, 0.3)
        pose = episode.slam.map.pose
        assert episode.ticks == tick == len(episode.poses) - 1
        np.testing.assert_array_equal(episode.poses[-1], episode.world.pose)
        np.testing.assert_array_equal(episode.estimates[-1], pose)
        expected = pose_nees(pose, episode.slam.map.pose_covariance, relative(episode.base, episode.world.pose))
        assert episode.nees[-1] == expected
    assert not episode.over


def test_straight_walls_correct_the_wheels_where_the_scenario_says_so() -> None:
    wheels, walls = (drive(start(short(25, "hall", wall_compass=on)), 25) for on in (False, True))
    np.testing.assert_array_equal(wheels.poses, walls.poses)  # the same world, driven the same way
    heading = [
        np.array([relative(wheels.poses[-2], wheels.poses[-1])[2], e.odometry.motion[2]]) for e in (wheels, walls)
    ]
    assert walls.odometry.covariance[2, 2] < 0.5 * wheels.odometry.covariance[2, 2]
    assert abs(np.diff(heading[1])) < 4.0 * np.sqrt(walls.odometry.covariance[2, 2])


def test_estimates_are_in_the_base_and_landmarks_in_the_world() -> None:
    episode = drive(start(), 30)
    estimate = compose(episode.base, episode.estimates[-1])
    assert np.hypot(*(estimate - episode.poses[-1])[:2]) < 0.2
    np.testing.assert_array_equal(episode.landmarks, transform(episode.base, episode.slam.map.confirmed))
    nearest = np.hypot(*(episode.landmarks[:, None] - episode.site.plan.features.positions).transpose(2, 0, 1))
    assert len(episode.landmarks) > 3 and np.median(nearest.min(axis=1)) < 0.15


def test_the_map_error_and_the_coverage_are_those_of_now() -> None:
    episode = start()
    assert episode.map_error() == 1.0  # nothing is confirmed by one look
    for _ in range(3):
        drive(episode, 5)
        expected = map_error(episode.landmarks, episode.targets, episode.scenario.prior_sigma)
        assert episode.map_error() == episode.map_error() == expected
        cells = observe(episode.base, episode.site.cells)
        grid = episode.grid
        columns, rows = np.floor((cells - grid.origin) / grid.resolution).astype(int).T
        assert episode.coverage() == pytest.approx(np.mean(grid.cells[rows, columns] != UNKNOWN))
    np.testing.assert_array_equal(episode.targets, episode.site.plan.features.positions[episode.site.observable])


def test_the_explored_grid_holds_the_whole_plan_however_the_robot_stands_in_it() -> None:
    for seed in range(5):
        episode = start(seed=seed)
        x0, y0, x1, y1 = episode.site.plan.bounds
        corners = observe(episode.base, np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
        far = episode.grid.origin + np.array(episode.grid.cells.shape[::-1]) * episode.grid.resolution
        assert (corners >= episode.grid.origin + 1.9).all() and (corners <= far - 1.9).all()


def test_two_halves_are_a_tick() -> None:
    whole, halves = start(associator="jcbb"), start(associator="nearest_neighbour")
    for _ in range(8):
        whole.tick(0.8, -0.3)
        prediction = halves.begin_tick(0.8, -0.3)
        halves.end_tick(prediction, jcbb(halves.scan, prediction))
    assert whole.ticks == halves.ticks == 8
    np.testing.assert_array_equal(whole.slam.map.mean, halves.slam.map.mean)
    np.testing.assert_array_equal(whole.grid.cells, halves.grid.cells)
    assert whole.identities.total == halves.identities.total


def test_what_happens_does_not_depend_on_who_associates() -> None:
    """The truth goes its way: the same drive, the same noise, whatever the map comes to."""
    one, other = (drive(start(associator=name), 20) for name in ("jcbb", "nearest_neighbour"))
    np.testing.assert_array_equal(one.poses, other.poses)
    np.testing.assert_array_equal(one.scan.points, other.scan.points)
    np.testing.assert_array_equal(one.odometry.motion, other.odometry.motion)


def test_virtual_landmarks_are_as_uncertain_in_the_world_as_the_pose_is_in_the_base() -> None:
    episode = start(virtual=True)
    episode.virtual_map.covariances[:], heading = np.eye(2), episode.base[2]
    episode.slam.map.place(episode.slam.map.pose, np.diag([0.5, 0.0, 0.0]))  # along x of B
    episode._explore()
    off = np.unique(episode.virtual_map.covariances[..., 0, 1].round(9))
    np.testing.assert_allclose(off[off != 0.0], 0.5 * np.cos(heading) * np.sin(heading), atol=1e-9)
    assert len(off) == 2


# --- sites ------------------------------------------------------------------------------------------------------------


def test_a_site_is_where_the_robot_gets_to_and_what_it_can_see_there() -> None:
    site, reach = site_of(SMALL), SMALL.sensor.range
    apart = np.hypot(*(site.plan.features.positions[:, None] - site.cells).transpose(2, 0, 1)).min(axis=1)
    assert site.observable.any() and (apart[site.observable] <= reach).all()
    x0, y0, x1, y1 = site.plan.bounds
    assert ((site.cells > [x0, y0]) & (site.cells < [x1, y1])).all()
