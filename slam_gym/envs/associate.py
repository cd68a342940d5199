"""`slam_gym/Associate-v0`: the agent is the associator, and a baseline drives."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from slam_gym.association.tracking.walk import Compatibility, Walk, check_arguments, nothing
from slam_gym.association.walks import Order
from slam_gym.envs.base import BaseEnv, Info, Observation, Settings, box, settings_of
from slam_gym.scenarios import SCENARIOS, Scenario, world_seed
from slam_gym.simulation.association_runs import DRIVERS, LOGS, AssociationRun, DrivenRun, Driver, LoggedRun, ScanLog
from slam_gym.simulation.judged import NOT_OFFERED, RightAnswers
from slam_gym.simulation.recorded_logs import PREFIX, recorded_log
from slam_gym.types import Hypothesis
from slam_gym.validation import check_number, one_of


@dataclass(frozen=True)
class AssociateSettings(Settings):
    """The arguments of `AssociateEnv`, which says what they are."""

    driver: str | Driver = "nearest_frontier"
    reward: Literal["truth", "map_error"] = "truth"
    candidates: int = 5
    order: Order = "as_scanned"
    compatibility: Compatibility = "joint"
    wrong_cost: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_arguments(self.candidates, self.order, self.compatibility)
        one_of("reward", self.reward, ("truth", "map_error"))
        if not callable(self.driver):
            one_of("driver", self.driver, DRIVERS)
        check_number("wrong_cost", self.wrong_cost)


class AssociateEnv(BaseEnv):
    """Decide where measurements come from, one after the other, while a robot explores and maps.

    ## Description
    A baseline drives a robot through a scenario. At every scan the agent walks the interpretation tree: level by level
    it pairs a measurement with a feature of the map, or with nothing (`*`). The hypothesis that results updates the
    map, for better or worse; which of the unpaired measurements start features is decided as in `Walk.hypothesis`.
    Levels with one legal branch, and scans without a choice, are played by the environment.

    ## Action space
    `Discrete(K + 1)` with K = `candidates`. Action a < K pairs the current measurement with the a-th of the legal
    candidates, by ascending D²_ij; K is `*`. `action_masks()` and `info["action_mask"]` are the compatibility test of
    the path; an illegal action is taken for `*`. Where K hides a candidate, `info["hidden"]` says how many.

    ## Observation space
    A flat `Dict` of float32 vectors in [−1, 1]: `measurement`, `candidates` (K rows) and `path`, as
    `slam_gym.association.tracking.walk` lists them, and `budget`, the fraction of the scans left. All but the
    last are what a policy sees as an associator elsewhere (`slam_gym.association.policy.from_policy`).

    ## Rewards
    - `reward="truth"`: a right pairing +1, a wrong one −`wrong_cost`, `*` 0, divided by the measurements in this scan
      of features that are *in the map* (at least 1), and by the number of scans after the first. So an episode returns
      the mean over its scans of (right − `wrong_cost` · wrong) / (measurements of mapped features): at most 1, exactly
      0 for refusing everything; and what a decision earns is known at once. Which features are in the map depends on
      earlier decisions. `info["score"]` is the same ratio taken over all scans together. The identity of a map feature
      is the source of the measurement that created it; of duplicates the oldest is right; a pairing with or of what has
      no label earns nothing.
    - `reward="map_error"`: the decrease of the map's error, as Explore scores it, when a scan has been learned from.
      Refused where nobody knows the true places of the features, as in most recordings; `map_error` stays 1 there.

    ## Info
    Free of the truth: `action_mask`, `hidden`, `look` (scans so far). Not for agents: `score` and `map_error` of the
    episode so far, and `truth`: the right `action`, −1 where it is not on offer.

    ## Starting state
    A world drawn from the seeds of the `split`; `reset(options={"world": i})` takes the i-th. On the reference corridor
    only the noise is drawn; on a recording, the window of the log. Same seed and options, same episode.

    ## Episode end
    The last scan is decided (`terminated`). An episode without any choice ends with its first step.

    ## Arguments
    Those of `slam_gym.envs.base.Settings`, with more scenarios; and:

    - `scenario`: also `"corridor"` (the reference experiment), or a `slam_gym.simulation.association_runs.ScanLog`; for
      a real log `"recording:FILE"`, `"recording:victoria_park"` or `"recording:mrclam/3"`, perhaps with
      `?looks=…&every=…` (see `slam_gym.simulation.recorded_logs`): sources that nobody knows count nowhere, what the
      labels leave out of a scan is spurious. Splits are disjoint parts of a recording; on another log they keep the
      seeds apart. `overrides` and floors are not for logs.
    - `driver`: `"nearest_frontier"`, `"random"`, or a callable from `Goals` and a generator to a slot.
    - `candidates`, `order`, `compatibility`: K, the order of the measurements, and what makes a branch legal (see
      `slam_gym.association.tracking.walk`); with `compatibility="individual"` features may be taken twice, as NN does.
    - `reward`: `"truth"` or `"map_error"`; `wrong_cost`: what a wrong pairing costs, in right ones.
    """

    settings = AssociateSettings
    arguments: AssociateSettings

    def __init__(self, scenario: str | Scenario | ScanLog | None = None, **arguments: Any) -> None:
        settings = settings_of(AssociateSettings, scenario, arguments)
        super().__init__(settings)
        self.scenario = _chosen(settings)
        self.places_known = not isinstance(self.scenario, ScanLog) or len(self.scenario.targets) > 0
        if settings.reward == "map_error" and not self.places_known:
            unknown = f"nobody knows where the features of {self.scenario.name!r} are"
            raise ValueError(f"reward={settings.reward!r}: {unknown}; known: truth")
        self._driver = settings.driver if callable(settings.driver) else DRIVERS[settings.driver]
        self.K = settings.candidates
        parts: dict[str, spaces.Space[Any]] = {name: box(len(part)) for name, part in nothing(self.K).items()}
        self.observation_space = spaces.Dict(parts | {"budget": box(1, 0.0)})
        self.action_space = spaces.Discrete(self.K + 1)
        self.walk: Walk | None = None  # of the scan to be decided; None where the episode is over
        self._ended = False
        self._right = self._wrong = self._known = 0  # measurements of the episode so far

    @property
    def run(self) -> AssociationRun:
        """The SLAM run that the agent associates for. Raises RuntimeError before the first reset."""
        self._started(getattr(self, "_run", None))
        return self._run

    @property
    def score(self) -> float:
        """(right − wrong_cost · wrong) / measurements of mapped features, of all scans so far, the present one counted
        in full; 0 at first."""
        return (self._right - self.arguments.wrong_cost * self._wrong) / max(self._known, 1)

    def action_masks(self) -> NDArray[np.bool_]:
        """(K + 1,) the actions that are legal now: the mask that sb3-contrib's MaskablePPO asks for."""
        self._started(getattr(self, "_run", None))
        if self.walk is not None:
            return self.walk.mask.copy()
        return np.equal(np.arange(self.K + 1), self.K)

    def right_action(self) -> int:
        """What the truth would decide now: K (`*`) for what is spurious or not mapped; −1 where the right feature is
        not on offer, or nobody knows."""
        return NOT_OFFERED if self.walk is None else self._answers.right_action(self.walk)

    def action_of(self, hypothesis: Hypothesis) -> int | None:
        """The action by which a hypothesis on the present scan decides now; None where that is not on offer."""
        return self.K if self.walk is None else self.walk.action_of(int(hypothesis.features[self.walk.measurement]))

    def _begin(self, world: int) -> Observation:
        self._run: AssociationRun = self._start(world)
        self.walk, self._ended = None, False
        self._right = self._wrong = self._known = 0
        self._proceed()
        self._last_error = self._run.map_error()
        return self._observe()

    def _act(self, action: int) -> float:
        """Decide the current measurement, and go on to the next choice, in this scan or a later one."""
        run, reward = self.run, 0.0
        if self.walk is not None:
            action = action if self.walk.mask[action] else self.K
            reward = self._earned(self.walk, action)
            self.walk.take(action)
        self._proceed()
        if self.arguments.reward == "map_error":
            error = run.map_error()
            reward, self._last_error = self._last_error - error, error
        self._ended = self.walk is None
        self._changed()
        return reward

    @property
    def over(self) -> bool:
        return self._ended

    def _picture(self) -> Any:
        from slam_gym.rendering import associate_view

        return associate_view.draw(self.run, self.walk, self._answers, self._figures())

    def _start(self, world: int) -> AssociationRun:
        if isinstance(self.scenario, ScanLog):
            stream = np.random.default_rng((world_seed(self.split, world), int(self.np_random.integers(2**63))))
            return LoggedRun(self.scenario, stream)
        return DrivenRun(self.scenario, self._survey(self.scenario, world), self._driver, self.np_random)

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
            self._answers = RightAnswers.of(run.truth, run.identities.source_of(run.slam.map.ids))
            self._known += self._answers.known
            self.walk = Walk(
                run.scan,
                run.prediction,
                candidates=self.K,
                order=self.arguments.order,
                compatibility=self.arguments.compatibility,
            )

    def _earned(self, walk: Walk, action: int) -> float:
        """What an action earns by the truth."""
        if action == self.K:
            return 0.0
        right, wrong = self._answers.judge(walk.measurement, int(self.run.prediction.features[walk.rows[action]]))
        self._right, self._wrong = self._right + right, self._wrong + wrong
        decisions = max(self._answers.known, 1) * max(self.run.length - 1, 1)
        return (right - self.arguments.wrong_cost * wrong) / decisions

    def _observe(self) -> Observation:
        run = self.run
        decision = nothing(self.K) if self.walk is None else self.walk.observation()
        return decision | {"budget": np.array([1.0 - run.scans / run.length], np.float32)}

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
            ("scan", f"{self.run.scans} of {self.run.length}"),
            ("score", f"{self.score:.2f}".replace("-", "−")),
            ("paired right", str(self._right)),
            ("paired wrong", str(self._wrong)),
            *map_error,
        )


def _chosen(settings: AssociateSettings) -> Scenario | ScanLog:
    """The log that the argument means, or the simulated scenario. Errors list the names of both."""
    given = settings.scenario
    log = given if isinstance(given, ScanLog) else None
    if isinstance(given, str):
        log = recorded_log(given, settings.split) if given.startswith(PREFIX) else LOGS.get(given)
    if log is not None:
        if settings.overrides or settings.floor_plan is not None or settings.resolution is not None:
            raise ValueError(f"overrides and floor plans are for simulated scenarios, and {log.name!r} is a log")
        return log
    if isinstance(given, str) and not set(given) & {"/", ":"}:  # no level of the suite, nor a name in a module
        names = (*SCENARIOS, *LOGS, f"{PREFIX}FILE", f"{PREFIX}victoria_park", f"{PREFIX}mrclam/1")
        one_of("scenario", given, names)
    return settings.scenario_on_floor
