"""`slam_gym/Explore-v0`: the agent drives, the associator is an argument, and the reward measures the map."""

import contextlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from slam_gym.association import resolve_associator
from slam_gym.association.prediction import Associator
from slam_gym.envs.base import BaseEnv, Info, Observation, Settings, settings_of
from slam_gym.envs.observation import encode_goals, observation_space, observe
from slam_gym.scenarios import Scenario
from slam_gym.simulation.driver import Command, commands
from slam_gym.simulation.episode import Episode
from slam_gym.simulation.goals import LOOK, SLOTS, Goals, propose
from slam_gym.simulation.quality import quality
from slam_gym.slam.atlas import AtlasSpec
from slam_gym.slam.relocate import LOCALITIES, SEARCH, LocalityName, relocate_by
from slam_gym.types import SPURIOUS, Relocator
from slam_gym.validation import one_of

REWARDS: dict[str, Callable[[Episode], float]] = {
    "map_error": Episode.map_error,
    "a_opt": lambda episode: episode.virtual_map.a_opt(),  # type: ignore[union-attr]
    "d_opt": lambda episode: episode.virtual_map.d_opt(),  # type: ignore[union-attr]
    "entropy": lambda episode: episode.virtual_map.entropy(),  # type: ignore[union-attr]
}
"""The quantities whose decrease in a step may be the reward: the rewards of an episode sum to the total decrease.

`map_error` uses the truth. The others do not: they are functions of the robot's own covariances over the fixed cells of
a virtual map, and therefore reward an overconfident associator. Of the truth they know no more than the bounds of the
building and the first pose in it.
"""


@dataclass(frozen=True)
class ExploreSettings(Settings):
    """The arguments of `ExploreEnv`, where they are documented."""

    associator: str | Associator | None = None
    action: Literal["goal", "twist"] = "goal"
    reward: Literal["map_error", "a_opt", "d_opt", "entropy"] = "map_error"
    locality: Literal["covisibility"] | None = "covisibility"
    relocation: str | Relocator | None = SEARCH
    relocation_locality: LocalityName | None = "covisibility"
    atlas: bool | AtlasSpec = True
    render_covisibility: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("action", self.action, ("goal", "twist"))
        one_of("reward", self.reward, REWARDS)
        one_of("locality", self.locality, ("covisibility", None))
        one_of("relocation_locality", self.relocation_locality, (*LOCALITIES, None))
        if not isinstance(self.atlas, bool | AtlasSpec):
            raise ValueError(f"atlas: expected True, False or an AtlasSpec, got {self.atlas!r}")
        if self.relocation is None and self.relocation_locality not in ("covisibility", None):
            raise ValueError(f"relocation_locality={self.relocation_locality!r}: no relocation would search it")


class ExploreEnv(BaseEnv):
    """Explore an unknown building with a robot whose SLAM depends on where it goes.

    ## Description
    A differential-drive robot starts in a building that it has never seen. At every tick it drives, reads its odometry,
    scans point features, and takes one step of EKF-SLAM, with data association by `associator`. The agent decides where
    the robot goes, and is rewarded for the map that results.

    ## Action space
    - `action="goal"`: `Discrete(16)`. Slot 0 looks around (always legal), 1–10 go to frontiers, nearest first, 11–15
      revisit known places that are expected to improve the map. A step lasts until the goal is reached, lost or out of
      date; `info["ticks"]` is its duration. `action_masks()` and `info["action_mask"]` say which slots are legal; an
      illegal slot looks around.
    - `action="twist"`: `Box(−1, 1, (2,))`, fractions of the greatest forward and turning speed, for one tick. An
      action outside the box, or NaN, raises ValueError.

    ## Observation space
    A flat `Dict` of float32 vectors, scaled into [−1, 1] or [0, 1], and one image, all relative to the estimated pose:
    `scan` and `features` (those that the map expected in the scan), nearest first, with `observation.POINT_FIELDS` per
    row; `uncertainty` (σ of x, y, θ); `budget` (fraction left); `image` (3, 48, 48) uint8: free space, walls, feature
    density, with the robot in the middle and its heading up; and, in goal mode, `goals` (`GOAL_FIELDS` per slot;
    `observation.unsquash_goals` converts them to their units).

    ## Rewards
    The decrease, since the last step, of `map_error`, which uses the truth, or of `a_opt`, `d_opt` or `entropy` of a
    virtual map, which do not use it and therefore reward overconfidence: see `slam_gym.envs.explore.REWARDS`.

    ## Info
    Free of the truth: `action_mask`, the estimated `pose` (3,) in B, `ticks` of the step, `lost`, `missed_loop`. Not
    for agents: `map_error`, `coverage`, the step's `pairings_right`, `pairings_wrong` and `pairings_missed`,
    `pose_nees` (NaN in a second map), `map_quality` when `terminated`, and `truth`: `pose` (3,) in W, and the `sources`
    of the scan, −1 for spurious measurements and beyond the last one.

    ## Starting state
    A world drawn from the seeds of the `split` (with `floor_plan`, always that floor), and a random free pose in it.
    `reset(options={"world": i})` selects the i-th world of the split. Same seed and options, same episode.

    ## Episode end
    The budget of ticks is spent (`terminated`); the observation contains the fraction that is left.

    ## Arguments
    Those of `slam_gym.envs.base.Settings`, and:

    - `associator`: a name, `"module:function"` or a callable from `Scan` and `Prediction` to `Hypothesis`; None: that
      of the scenario, `"learned"` in `building` and where drift is large, otherwise `"jcbb"`.
    - `locality`: `"covisibility"`: JCBB and others search among near features first; None: at once among all.
    - `relocation`: the search that relocates a lost robot, by name (`slam_gym.association.RELOCATORS`),
      `"module:function"` or a callable; None: a lost robot is not relocated. `relocation_locality`: `"covisibility"`,
      `"two-hop covisibility"`, `"distance"` or None. `atlas`: with relocation, loops are closed as well, and a robot
      that remains lost starts another map, which is joined once a place is recognised; False: neither.
    - `render_covisibility`: the picture shows the edges of the covisibility graph. `"rgb_array_list"` has one picture
      per tick.
    """

    metadata = BaseEnv.metadata | {"render_fps": 10}

    settings = ExploreSettings
    arguments: ExploreSettings

    def __init__(self, scenario: str | Scenario | None = None, **arguments: Any) -> None:
        settings = settings_of(ExploreSettings, scenario, arguments)
        super().__init__(settings)
        self.scenario = settings.scenario_on_floor
        self.goal_mode = settings.action == "goal"
        self.associator = self.scenario.associator if settings.associator is None else settings.associator
        resolve_associator(self.associator)  # raises for an unknown one
        self.relocate = None
        if settings.relocation is not None:
            self.relocate = relocate_by(settings.relocation, settings.relocation_locality)
        self.atlas = None
        if self.relocate and settings.atlas:
            self.atlas = AtlasSpec() if settings.atlas is True else settings.atlas
        self._episode: Episode | None = None
        self._error = REWARDS[settings.reward]
        self.measurements = self.scenario.sensor.max_features
        self.observation_space = observation_space(self.measurements, self.goal_mode)
        self.action_space = spaces.Discrete(SLOTS) if self.goal_mode else spaces.Box(-1.0, 1.0, (2,), np.float32)

    @property
    def episode(self) -> Episode:
        """The running episode. Raises RuntimeError before the first reset."""
        return self._started(self._episode)

    @property
    def goals(self) -> Goals:
        """The goals on offer. Raises RuntimeError in twist mode, where there are none, and before the first reset."""
        self._started(self._episode)
        if not self.goal_mode:
            raise RuntimeError("there are goals in goal mode only")
        return self._goals

    def action_masks(self) -> NDArray[np.bool_]:
        """(SLOTS,) the slots that are legal now, as sb3-contrib's MaskablePPO expects them."""
        if not self.goal_mode:
            raise AttributeError("action masks exist in goal mode only")
        return self.goals.legal.copy()

    def map_quality(self) -> dict[str, float]:
        """All measures of the map, the trajectory and the associations in the episode so far."""
        return quality(self.episode)

    def _begin(self, world: int) -> Observation:
        self._episode = Episode(
            self.scenario,
            self._survey(self.scenario, world),
            self.associator,
            self.np_random,
            locality=self.arguments.locality is not None,
            virtual=self.arguments.reward != "map_error",
            relocate=self.relocate,
            atlas=self.atlas,
        )
        self._begin_step()
        observation = self._observe()  # first, so that the start is no goal yet
        self.episode.places.pass_by(self.episode.estimates[0][:2])
        self._last_error = self._error(self.episode)
        return observation

    def _act(self, action: Any) -> float:
        episode = self.episode
        self._begin_step()
        orders: Iterable[Command]
        if self.goal_mode:
            slot = action if self._goals.legal[action] else LOOK
            orders = commands(episode, slot, self._goals.positions[slot], self._goals.ways)
        else:
            orders = [(action[0], action[1])]
        for forward, turn in orders:
            episode.tick(forward, turn)
            self._changed()
        error = self._error(episode)
        reward, self._last_error = self._last_error - error, error
        return reward

    @property
    def over(self) -> bool:
        return self.episode.over

    def _picture(self) -> Any:
        from slam_gym.rendering import explore_view

        goals = self._goals.positions[1:][self._goals.legal[1:]] if self.goal_mode else np.empty((0, 2))
        return explore_view.draw(self.episode, goals, covisibility=self.arguments.render_covisibility)

    def _checked(self, action: Any) -> Any:
        if self.goal_mode:
            return super()._checked(action)
        with contextlib.suppress(TypeError, ValueError):  # of what is no pair of numbers
            forward, turn = np.asarray(action, np.float64).tolist()
            if -1.0 <= forward <= 1.0 and -1.0 <= turn <= 1.0:
                return forward, turn
        raise ValueError(f"action {action!r}: expected two fractions (forward, turn) in [−1, 1]")

    def _begin_step(self) -> None:
        self._decided_before = self.episode.identities.decided
        self._ticks_before = self.episode.ticks

    def _observe(self) -> Observation:
        episode = self.episode
        slam_map, expected = episode.slam.map, episode.last_step.prediction
        left = 1.0 - episode.ticks / self.scenario.budget  # fraction of the budget
        observation: Observation = observe(episode.scan, expected, slam_map, episode.grid, self.measurements, left)
        if self.goal_mode:
            self._goals = propose(self.scenario, slam_map, episode.grid, episode.places, episode.tried)
            observation["goals"] = encode_goals(self._goals, slam_map.pose)
        return observation

    def _info(self) -> Info:
        episode = self.episode
        right, *wrong, missed = [now - then for now, then in zip(episode.identities.decided, self._decided_before)]
        sources, truth = np.full(self.measurements, SPURIOUS), episode.truth
        sources[: len(truth.sources)] = truth.sources
        info: Info = {
            "map_error": episode.map_error(),
            "coverage": episode.coverage(),
            "pairings_right": right,
            "pairings_wrong": sum(wrong),
            "pairings_missed": missed,
            "pose_nees": episode.nees[-1],
            "ticks": episode.ticks - self._ticks_before,
            "pose": episode.estimates[-1].copy(),
            "lost": episode.slam.lost,
            "missed_loop": episode.slam.missed_loop,
            "truth": {"pose": truth.pose.copy(), "sources": sources},
        }
        if self.goal_mode:
            info["action_mask"] = self._goals.legal.copy()
        if episode.over:
            info["map_quality"] = self.map_quality()
        return info
