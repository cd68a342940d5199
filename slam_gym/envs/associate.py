"""`slam_gym/Associate-v0`: the agent is the associator, and a baseline drives."""

from __future__ import annotations

import copy
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from slam_gym.association.tracking.observation import lengths, nothing
from slam_gym.association.tracking.walk import Compatibility, Order, Walk, check_arguments
from slam_gym.envs.warm_up import compile_on_two_cores
from slam_gym.scenarios import SCENARIOS, SPLITS, Scenario, get_scenario, world_generator, world_seed
from slam_gym.simulation.association_runs import (
    DRIVERS,
    LOGS,
    AssociationRun,
    DrivenRun,
    Driver,
    LoggedRun,
    ScanLog,
)
from slam_gym.simulation.episode import Site, survey
from slam_gym.simulation.recorded_logs import PREFIX, recorded_log
from slam_gym.simulation.verdicts import Verdicts
from slam_gym.types import NONE, Hypothesis
from slam_gym.validation import one_of

Observation = dict[str, Any]
Info = dict[str, Any]
Snapshot = dict[str, Any]


class AssociateEnv(gym.Env[Observation, Any]):
    """Decide where measurements come from, one after the other, while a robot explores and maps.

    ## Description
    A baseline drives a robot through a scenario. At every scan the agent walks the interpretation tree: level by level
    it pairs a measurement with a feature of the map, or with nothing (`*`). The hypothesis that results updates the
    map, for better or worse. Levels with one legal branch, and scans without a choice, are played by the environment.

    ## Action space
    `Discrete(K + 1)` with K = `candidates`. Action a < K pairs the current measurement with the a-th of the legal
    candidates, by ascending D²_ij; K is `*`. `action_masks()` and `info["action_mask"]` are the compatibility test of
    the path; an illegal action is taken for `*`. Where K hides a candidate, `info["hidden"]` says how many.

    ## Observation space
    A flat `Dict` of float32 vectors in [−1, 1]: `measurement`, `candidates` (K rows), `path` and `pairings`, as
    `slam_gym.association.tracking.observation` lists them, and `budget`, the share of looks left. The first four are
    what a policy sees as an associator elsewhere (`slam_gym.association.tracking.policy.from_policy`).

    ## Rewards
    - `reward="truth"`: a right pairing +1, a wrong one −`wrong_cost`, `*` 0, divided by the measurements of features
      *seen before* in this scan (at least 1), and by the number of looks after the first. So an episode returns the
      mean over its scans of what domain figures call the score: at most 1; exactly 0 for refusing everything; and what
      a decision earns is known at once and does not depend on what was decided before. `info["score"]` is the same
      ratio taken over all scans together. The identity of a map feature is the source of the measurement that created
      it; of duplicates the oldest is right; a pairing with or of what has no label earns nothing.
    - `reward="map_error"`: the decrease of the map's error, as Explore scores it, when a scan has been learned from.
      Refused where nobody knows the true places of the features, as in most recordings; `map_error` stays 1 there.

    ## Starting state
    A world drawn from the seeds of the `split`; `reset(options={"world": i})` takes the i-th. On the reference corridor
    only the noise is drawn; on a recording, the window of the log. Same seed and options, same episode.

    ## Episode end
    The last scan is decided (`terminated`). An episode without any choice ends with its first step.

    ## Arguments
    - `scenario`: a name from `slam_gym.scenarios.SCENARIOS`, `"corridor"` (the reference experiment), a `Scenario`,
      or a `slam_gym.simulation.association_runs.ScanLog`; for a real log `"recording:FILE"`,
      `"recording:victoria_park"` or `"recording:mrclam/3"`, perhaps with `?looks=…&every=…` (see
      `slam_gym.simulation.recorded_logs`): sources that nobody knows count nowhere, what the labels leave out of a
      scan is spurious.
    - `split`: `"train"` or `"test"`, whose worlds never overlap, nor do the parts of a recording; on another log it
      keeps the seeds apart.
    - `driver`: `"nearest_frontier"`, `"random"`, or a callable from `Goals` and a generator to a slot.
    - `candidates`, `order`, `compatibility`: K, the order of the measurements, and what makes a branch legal (see
      `slam_gym.association.tracking.walk`); with `compatibility="individual"` features may be taken twice, as NN does.
    - `wrong_cost`: what a wrong pairing costs, in right ones.
    - `render_mode`: `"rgb_array"` or `"human"`.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 4}  # noqa: RUF012 (Gymnasium's convention)

    def __init__(
        self,
        scenario: str | Scenario | ScanLog = "office",
        split: Literal["train", "test"] = "train",
        driver: str | Driver = "nearest_frontier",
        reward: Literal["truth", "map_error"] = "truth",
        candidates: int = 5,
        order: Order = "as_scanned",
        compatibility: Compatibility = "joint",
        wrong_cost: float = 10.0,
        render_mode: Literal["rgb_array", "human"] | None = None,
    ) -> None:
        check_arguments(candidates, order, compatibility)
        one_of("split", split, SPLITS)
        one_of("reward", reward, ("truth", "map_error"))
        one_of("render_mode", render_mode, (None, *self.metadata["render_modes"]))
        if not 0.0 <= wrong_cost < np.inf:
            raise ValueError(f"wrong_cost={wrong_cost}: expected a finite number ≥ 0")
        if isinstance(scenario, str):
            scenario = _named(scenario, split)
        if not callable(driver):
            one_of("driver", driver, DRIVERS)
            driver = DRIVERS[driver]
        self.places_known = not isinstance(scenario, ScanLog) or len(scenario.targets) > 0
        if reward == "map_error" and not self.places_known:
            raise ValueError(
                f"reward={reward!r}: nobody knows where the features of {scenario.name!r} are; known: truth"
            )
        self.scenario, self.split, self.render_mode = scenario, split, render_mode
        self._driver, self._of_truth, self._wrong_cost = driver, reward == "truth", wrong_cost
        self.K, self.order, self.compatibility = candidates, order, compatibility
        parts: dict[str, spaces.Space[Any]] = {
            name: spaces.Box(-1.0, 1.0, (length,), np.float32) for name, length in lengths(candidates).items()
        }
        self.observation_space = spaces.Dict(parts | {"budget": spaces.Box(0.0, 1.0, (1,), np.float32)})
        self.action_space = spaces.Discrete(candidates + 1)
        self.walk: Walk | None = None  # of the scan to be decided; None where the episode is over
        self._site: Site | None = None
        self._run: AssociationRun | None = None
        self._renderer: Any = None
        self._ended = False

    # -- Gymnasium ---------------------------------------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, Info]:
        """Start an episode. `options={"world": i}` chooses the world; any other option raises ValueError."""
        options = dict(options or {})
        if unknown := set(options) - {"world"}:
            raise ValueError(f"unknown reset option {sorted(unknown)[0]!r}; known: world")
        world_seed(self.split, options.get("world", 0))  # refuses a world outside the split, while nothing has changed
        super().reset(seed=seed)
        self._snapshot: Snapshot = {
            "generator": copy.deepcopy(self.np_random.bit_generator.state),
            "options": options,
            "actions": [],
        }
        world = options.get("world", int(self.np_random.integers(SPLITS[self.split][1])))
        compile_on_two_cores()
        self._run = self._start(world)
        self.walk, self._last_error = None, 1.0
        self._right = self._wrong = self._known = 0
        self._proceed()
        self._last_error = self._run.map_error()
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info()

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, Info]:
        """Decide the current measurement, and go on to the next choice, in this scan or a later one."""
        run = self.run
        if self._ended:
            raise RuntimeError("the episode is over: call reset()")
        if not self.action_space.contains(action):
            raise ValueError(f"action {action!r} is not one of 0 … {self.K}")
        self._snapshot["actions"].append(int(action))
        reward = 0.0
        if self.walk is not None:
            action = int(action) if self.walk.mask[action] else self.K
            reward = self._judge(action)
            self.walk.take(action)
        learned = run.scans
        self._proceed()
        if not self._of_truth:
            reward = 0.0
            if run.scans > learned or self.walk is None:
                error = run.map_error()
                reward, self._last_error = self._last_error - error, error
        self._ended = self.walk is None
        if self.render_mode == "human":
            self.render()
        return self._observe(), reward, self._ended, False, self._info()

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """(h, w, 3) picture in `rgb_array` mode; in `human` mode the window is updated and None returned."""
        if self.render_mode is None:
            gym.logger.warn("render() without a render_mode: pass render_mode='rgb_array' or 'human' to gym.make")
            return None
        # pygame is an extra, and runs without pictures never need it
        from slam_gym.rendering.associate_view import TreeRenderer

        if self._renderer is None:
            mode: Any = self.render_mode
            self._renderer = TreeRenderer(mode, fps=float(self.metadata["render_fps"]))
        picture: NDArray[np.uint8] | None = self._renderer.draw(self.run, self.walk, self._verdicts, self._figures())
        return picture

    def close(self) -> None:
        """Close the window, if there is one. May be called twice."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    # -- beyond Gymnasium --------------------------------------------------------------------------------------------

    @property
    def run(self) -> AssociationRun:
        """The SLAM run that the agent associates for. Raises RuntimeError before the first reset."""
        if self._run is None:
            raise RuntimeError("no episode yet: call reset() first")
        return self._run

    @property
    def score(self) -> float:
        """(right − wrong_cost · wrong) / measurements of features seen before, of the episode so far; 0 at first."""
        return (self._right - self._wrong_cost * self._wrong) / max(self._known, 1)

    def action_masks(self) -> NDArray[np.bool_]:
        """(K + 1,) the actions that are legal now: the mask that sb3-contrib's MaskablePPO asks for."""
        if self.walk is not None:
            return self.walk.mask.copy()
        return np.equal(np.arange(self.K + 1), self.K)

    def right_action(self) -> int:
        """What the truth would decide now: K (`*`) for what is spurious or not mapped; −1 where the right feature is
        not on offer, or nobody knows."""
        return NONE if self.walk is None else self._verdicts.right_action(self.walk)

    def action_of(self, hypothesis: Hypothesis) -> int | None:
        """The action by which a hypothesis on the present scan decides now; None where that is not on offer."""
        if self.walk is None:
            return self.K
        feature = hypothesis.features[self.walk.measurement]
        row = NONE if feature == NONE else int(np.searchsorted(self.run.prediction.features, feature))
        return self.walk.action_of(row)

    def snapshot(self) -> Snapshot:
        """What it takes to come back here: the generator at the last reset, its options, and the actions since."""
        self.run  # noqa: B018 (raises before the first reset)
        return copy.deepcopy(self._snapshot)

    def restore(self, snapshot: Snapshot) -> tuple[Observation, Info]:
        """Replay a snapshot of an env with the same arguments; returns its last observation and info."""
        generator = np.random.default_rng()
        generator.bit_generator.state = copy.deepcopy(snapshot["generator"])
        self.np_random = generator
        observation, info = self.reset(options=snapshot["options"])
        for action in snapshot["actions"]:
            observation, _, _, _, info = self.step(action)
        return observation, info

    # -- parts of a step ---------------------------------------------------------------------------------------------

    def _start(self, world: int) -> AssociationRun:
        self._ended = False
        if isinstance(self.scenario, ScanLog):
            stream = np.random.default_rng((world_seed(self.split, world), int(self.np_random.integers(2**63))))
            return LoggedRun(self.scenario, stream)
        plan = self.scenario.generator(world_generator(self.split, world))
        if self._site is None or self._site.plan is not plan:  # a given floor plan is surveyed once
            self._site = survey(plan, self.scenario)
        return DrivenRun(self.scenario, self._site, self._driver, self.np_random)

    def _proceed(self) -> None:
        """Learn from scans that are decided, and look on, until there is a choice or the run is over."""
        run = self.run
        while self.walk is None or self.walk.done:
            if self.walk is not None:
                run.associate(self.walk.hypothesis())
                self.walk = None
            if run.over:
                return
            run.next_scan()
            self._verdicts = Verdicts.of(run.truth, run.identities.source_of(run.slam.map.ids))
            self._known += self._verdicts.known
            self.walk = Walk(
                run.scan,
                run.prediction,
                candidates=self.K,
                order=self.order,
                compatibility=self.compatibility,
            )

    def _judge(self, action: int) -> float:
        """What an action earns by the truth."""
        assert self.walk is not None
        if action == self.K:
            return 0.0
        feature = int(self.run.prediction.features[self.walk.rows[action]])
        right, wrong = self._verdicts.judge(self.walk.measurement, feature)
        self._right, self._wrong = self._right + right, self._wrong + wrong
        share = max(self._verdicts.known, 1) * max(self.run.length - 1, 1)
        return (right - self._wrong_cost * wrong) / share

    def _observe(self) -> Observation:
        run = self.run
        observation = nothing(self.K) if self.walk is None else self.walk.observation()
        return observation | {"budget": np.array([1.0 - run.scans / run.length], np.float32)}

    def _info(self) -> Info:
        return {
            "look": self.run.scans,
            "hidden": 0 if self.walk is None else self.walk.hidden,
            "score": self.score,
            "map_error": self.run.map_error(),
            "action_mask": self.action_masks(),
            "truth": {"action": self.right_action()},
        }

    def _figures(self) -> tuple[tuple[str, str], ...]:
        map_error = (("map error", f"{self.run.map_error():.2f}"),) if self.places_known else ()
        return (
            ("look", f"{self.run.scans} of {self.run.length}"),
            ("score", f"{self.score:.2f}"),
            ("paired right", str(self._right)),
            ("paired wrong", str(self._wrong)),
            *map_error,
        )


def _named(scenario: str, split: str) -> Scenario | ScanLog:
    """The scenario or log of that name."""
    if scenario.startswith(PREFIX):
        return recorded_log(scenario, split)
    if scenario in LOGS:
        return LOGS[scenario]
    if "/" not in scenario:
        one_of(
            "scenario", scenario, (*SCENARIOS, *LOGS, f"{PREFIX}FILE", f"{PREFIX}victoria_park", f"{PREFIX}mrclam/1")
        )
    return get_scenario(scenario)
