"""What covisibility locality saves JCBB while tracking, and what, if anything, it loses.

The same exploration (nearest frontier, planned over the estimate) with JCBB told of covisibility localities and
without, on the same test worlds. Pairing tests are those for individual compatibility; nodes and joint tests are the
search's. Times are those of the associator's calls alone. The linear bound of relocation is another matter: here a
prior on the pose has already gated the candidates, so the saving is in pairing tests, and grows with what is in reach.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from slam_gym.association import jcbb
from slam_gym.bench.exploration import explore, explorer
from slam_gym.bench.records import Record, column, means
from slam_gym.bench.report import Report
from slam_gym.bench.timing import timed
from slam_gym.scenarios import get_scenario
from slam_gym.types import Hypothesis, Prediction, Scan


@dataclass(eq=False)
class RecordedJcbb:
    """JCBB, and what its calls took."""

    calls: list[Record] = field(default_factory=list)

    def __call__(self, scan: Scan, prediction: Prediction) -> Hypothesis:
        hypothesis, microseconds = timed(jcbb, scan, prediction)
        effort = hypothesis.effort
        self.calls.append({
            "pairing tests": effort.individual_tests,
            "nodes": effort.nodes,
            "joint tests": effort.joint_tests,
            "µs a scan": microseconds,
            "limits hit": effort.limit_hit,
        })  # fmt: skip
        return hypothesis


def track(scenario: str, locality: str | None, episodes: int, budget: int | None) -> Record:
    """Effort a scan and quality of the map, means over the episodes."""
    associator, settings = RecordedJcbb(), get_scenario(scenario)
    if budget:
        settings = replace(settings, budget=budget)
    env = explorer(settings, split="test", associator=associator, locality=locality)
    ends = [list(explore(env, number, world=number))[-1].info["map_quality"] for number in range(episodes)]
    row = {"scenario": scenario, "locality": locality or "everything"}
    row |= means(associator.calls, "pairing tests", "nodes", "joint tests", "µs a scan")
    row |= means(ends, "precision", "recall", "map_error", "duplicates")
    return row | {"limits hit": int(column(associator.calls, "limits hit").sum())}


def run(
    report: Report,
    *,
    episodes: int = 6,
    budget: int | None = None,
    scenarios: tuple[str, ...] = ("office", "aliased", "hall", "crowd"),
) -> None:
    """One row for each scenario, with and without locality.

    Arguments:
        episodes: test worlds 0 … N−1 of a scenario
        budget: [ticks] an episode lasts, instead of the scenario's
        scenarios: by name
    """
    rows = [track(name, locality, episodes, budget) for name in scenarios for locality in ("covisibility", None)]
    report.table("JCBB while tracking", rows, "tracking")
