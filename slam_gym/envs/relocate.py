"""`slam_gym/Relocate-v0`: the agent locates a kidnapped robot in a map, without a prior on its pose."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from slam_gym.association import resolve_associator
from slam_gym.association.prediction import Associator
from slam_gym.association.relocation.walk import RelocationWalk, WalkSpec, observe_walk, walk_shapes
from slam_gym.association.walks import Order
from slam_gym.envs.base import BaseEnv, Info, Observation, Settings, box, chosen_scenario, settings_of
from slam_gym.scenarios import SPLITS, Scenario
from slam_gym.simulation.judged import NOT_OFFERED
from slam_gym.simulation.kidnapping import is_right
from slam_gym.simulation.relocation_problems import Kidnapped, MappedWorld, kidnap
from slam_gym.slam.relocate import LOCALITIES, LocalityName
from slam_gym.types import UNPAIRED, IntArray
from slam_gym.validation import check_count, check_number, one_of


@dataclass(frozen=True)
class RelocateSettings(Settings):
    """The arguments of `RelocateEnv`, where they are documented."""

    locality: LocalityName | None = "covisibility"
    candidates: int = 8
    order: Order = "fewest_candidates"
    node_limit: int = 300
    sizes: bool = True
    outside: float = 0.25
    kidnappings_per_map: int = 20
    associator: str | Associator | None = None
    node_cost: float = 0.001
    wrong_cost: float = 1.0
    position_tolerance: float = 0.3
    heading_tolerance: float = math.radians(3.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("locality", self.locality, (*LOCALITIES, None))
        check_number("outside", self.outside, 1.0)
        check_count("kidnappings_per_map", self.kidnappings_per_map)
        for name in ("node_cost", "wrong_cost", "position_tolerance", "heading_tolerance"):
            check_number(name, getattr(self, name))


class RelocateEnv(BaseEnv):
    """Locate the robot from one scan and one map, without a prior.

    ## Description
    The robot has been carried to another place, inside its map or outside. The agent walks the interpretation tree of
    the scan: level by level it pairs a measurement with a feature of the map, or leaves it unpaired (`*`). A pairing is
    legal if it satisfies the constraints that hold for every pose: unary constraints, distances to and orientation of
    all earlier pairings, and the locality of the first pairing. Levels at which only `*` is legal are skipped. At a
    leaf the pose is estimated and the hypothesis takes the joint test; the best hypothesis so far is remembered. The
    agent may return to the root as long as nodes are left.

    ## Action space
    `Discrete(K + 2)` with K = `candidates`. Action a < K pairs the current measurement with the a-th legal feature.
    Features are ranked by the number of other measurements that would keep a legal partner (at the root: a partner in
    the feature's locality at a consistent distance). Action K is `*`, and at a leaf it stops. Action K + 1 restarts:
    the hypothesis of the path is evaluated as at a leaf, and the next try begins at the root, which costs a node.
    `action_masks()` and `info["action_mask"]` say which actions are legal; an illegal action counts as `*`.
    `info["hidden"]` is the number of candidates beyond the first K.

    ## Observation space
    A flat `Dict` of float32 vectors in [−1, 1]: `measurement`, `candidates` (K rows), `scan`, `path` and `search`, as
    `slam_gym.association.relocation.walk` lists them.

    ## Rewards
    −`node_cost` for every node of a step and, at the end, a reward for the best hypothesis. The hypothesis is accepted
    if it has as many pairings as `slam_gym.association.acceptance` requires and no other pose was found that explains
    as many measurements. If accepted, it earns 1 for a right pose and −`wrong_cost` for a wrong one; otherwise the
    reward is 1 outside the map and 0 inside. A pose is right if it lies within `position_tolerance` and
    `heading_tolerance` of the true pose in the map's frame. The rigid motion that aligns the true features in reach
    with their mapped counterparts transforms the true pose to that frame, so that the map's drift does not count as an
    error of the agent.

    ## Info
    Free of the truth: `action_mask`, `hidden`, `nodes` and `tries` so far, the `pairings` of the best hypothesis, how
    many are `needed`, and whether it is `accepted`. Not for agents: `score` when `terminated` (`right`, `wrong`,
    `nodes`), and `truth`: `inside`, the `pose` (3,) in B (zeros outside), the `features` of the measurements, and the
    right `action`.

    ## Starting state
    A robot has explored a world drawn from the seeds of the `split`, with a baseline driver and `associator`. Inside
    the map, the scan is taken at a place that the robot has visited, with a random heading, and has at least 5
    measurements of mapped features if such places exist; outside, it is from another world. From a reset with a seed
    on, `kidnappings_per_map` successive episodes are in one world, since mapping takes longer than an episode.
    `reset(options={"world": i})` selects the i-th world of the split. Same seed and options, same episode; maps made
    before make no difference.

    ## Episode end
    The agent stops, or no nodes are left (`terminated`). The observation contains the fraction that is left.

    ## Arguments
    Those of `slam_gym.envs.base.Settings` (with `floor_plan`, scans from outside are from the scenario's worlds), and:

    - `locality`: `"covisibility"`, `"two-hop covisibility"`, `"distance"` or None.
    - `candidates`, `order`, `node_limit`, `sizes`: see `slam_gym.association.relocation.walk.WalkSpec`.
    - `outside`: probability that the robot is not in the map; `kidnappings_per_map`: successive episodes in one world.
    - `node_cost`, `wrong_cost`: costs of a node and of a wrong answer, where a right answer earns 1;
      `position_tolerance` [m] and `heading_tolerance` [rad]: largest errors of a right pose.
    - `associator`: the associator with which the map is made, by default that of the scenario.
    """

    settings = RelocateSettings
    arguments: RelocateSettings

    def __init__(self, scenario: str | Scenario | None = None, **arguments: Any) -> None:
        settings = settings_of(RelocateSettings, scenario, arguments)
        super().__init__(settings)
        self.scenario = settings.scenario_on_floor
        # a floor plan has no other worlds: scans from outside are from the scenario's worlds
        self._elsewhere = None
        if settings.floor_plan is not None:
            self._elsewhere = chosen_scenario(scenario or "building", settings.overrides)
        self.walk_spec = WalkSpec(
            settings.candidates, settings.order, settings.node_limit, settings.sizes, self.scenario.slam.map.confidence
        )
        self._associator = self.scenario.associator if settings.associator is None else settings.associator
        resolve_associator(self._associator)  # raises for an unknown one
        self.measurements = self.scenario.sensor.max_features
        shapes = walk_shapes(settings.candidates, self.measurements)
        self.observation_space = spaces.Dict({name: box(rows * columns) for name, (rows, columns) in shapes.items()})
        self.action_space = spaces.Discrete(self.walk_spec.actions)
        self._maps: dict[int, MappedWorld] = {}
        self._walk: RelocationWalk | None = None

    @property
    def walk(self) -> RelocationWalk:
        """The walk of the running episode. Raises RuntimeError before the first reset."""
        return self._started(self._walk)

    def action_masks(self) -> NDArray[np.bool_]:
        """(K + 2,) the actions that are legal now, as sb3-contrib's MaskablePPO expects them."""
        mask = self.walk.mask
        mask[self.walk_spec.star] = True  # also after the end of the episode
        return mask

    def verdict(self) -> tuple[int, int]:
        """(right, wrong) for the present answer: (1, 0), (0, 1), or (0, 0) for no answer inside the map."""
        answer, inside = self.walk.best, self.kidnapped.inside
        if not answer.accepted:
            return int(not inside), 0
        tolerances = self.arguments.position_tolerance, self.arguments.heading_tolerance
        right = inside and is_right(answer.pose, self.kidnapped.pose, *tolerances)
        return int(right), int(not right)

    def right_action(self) -> int:
        """The right action: K (`*`) for a measurement that is spurious or not mapped and at a leaf, −1 where the
        right feature is not among the candidates."""
        action = self.action_of(self.kidnapped.features)
        return NOT_OFFERED if action is None else action

    def action_of(self, features: IntArray) -> int | None:
        """The action that follows the hypothesis `features` (m,), or stops; None if it is not among the candidates."""
        i = self.walk.measurement
        return self.walk_spec.star if i is None else self.walk.action_of(int(features[i]))

    def _draw_world(self, options: dict[str, Any]) -> int:
        """The world in `options`, else the world of the series, else, where the series has ended, a new world."""
        if "world" in options:
            return int(options["world"])
        if not self._series:
            drawn = int(self.np_random.integers(SPLITS[self.split][1]))
            self._series = drawn, self.arguments.kidnappings_per_map
        world, remaining = self._series
        self._series = (world, remaining - 1) if remaining > 1 else ()
        return world

    def _begin(self, world: int) -> Observation:
        if world not in self._maps:  # the last map is kept, since several episodes have it
            made = MappedWorld(self.scenario, self.split, world, self._associator, self._elsewhere)
            self._maps = {world: made}
        self.mapped = self._maps[world]
        if self.mapped.elsewhere is None and self.arguments.outside > 0.0:
            raise ValueError(
                f"outside={self.arguments.outside}: the scenario has one world only; outside=0.0 stays in it"
            )
        inside = bool(self.np_random.random() >= self.arguments.outside)
        self.kidnapped: Kidnapped = kidnap(self.mapped, self.scenario, inside, self.np_random)
        landmarks, locality = self.mapped.landmarks, self.mapped.locality(self.arguments.locality)
        self._walk = RelocationWalk(self.walk_spec, self.kidnapped.scan, landmarks, locality)
        return self._observe()

    def _act(self, action: int) -> float:
        """Decide the current measurement, restart, or stop."""
        walk = self.walk
        nodes = walk.nodes
        walk.take(action if walk.mask[action] else self.walk_spec.star)
        reward = -self.arguments.node_cost * (walk.nodes - nodes)
        if walk.done:
            right, wrong = self.verdict()
            reward += right - self.arguments.wrong_cost * wrong
        self._changed()
        return reward

    @property
    def over(self) -> bool:
        return self.walk.done

    def _picture(self) -> Any:
        from slam_gym.rendering import relocate_view

        return relocate_view.draw(self.walk, self.mapped, self.kidnapped, self._figures())

    def _carried_over(self) -> dict[str, Any]:
        return super()._carried_over() | {"_maps": dict(self._maps)}  # maps take long to make

    def _observe(self) -> Observation:
        return dict(observe_walk(self.walk, self.measurements))

    def _info(self) -> Info:
        walk, kidnapped = self.walk, self.kidnapped
        features = np.full(self.measurements, UNPAIRED)
        features[: len(kidnapped.features)] = kidnapped.features
        info: Info = {
            "nodes": walk.nodes,
            "tries": walk.tries,
            "hidden": walk.hidden,
            "pairings": walk.best.pairings,
            "needed": walk.needed,
            "accepted": walk.best.accepted,
            "action_mask": self.action_masks(),
            "truth": {
                "inside": kidnapped.inside,
                "pose": np.nan_to_num(kidnapped.pose),  # outside there is no pose
                "features": features,
                "action": self.right_action(),
            },
        }
        if walk.done:
            right, wrong = self.verdict()
            info["score"] = {"right": right, "wrong": wrong, "nodes": walk.nodes}
        return info

    def _figures(self) -> tuple[tuple[str, str], ...]:
        walk, best = self.walk, self.walk.best
        distance = f"{best.joint_distance:.1f}, dof {best.dof}" if best.pairings else "–"
        return (
            ("try", str(walk.tries)),
            ("nodes", f"{walk.nodes} of {self.walk_spec.node_limit}"),
            ("paired", f"{best.pairings}, {walk.needed} needed"),
            ("D², best", distance),
        )
