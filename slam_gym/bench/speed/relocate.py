"""Kidnapped robots found again: searches and policies on the episodes of `Relocate-v0`, success against nodes.

Every method is given the same scans, from inside and outside of maps that a robot made by SLAM with JCBB, and the
locality by covisibility. `right`: believed, and the pose within .3 m and 3° of the truth in the map; `wrong`: believed,
and elsewhere; the rest gave no answer. Outside, whatever is believed is wrong. Policies are `greedy` (one try, always
the candidate with most support) and `sampled` (random tries until one is believed), K = 8 candidates on offer. Nodes of
a policy are decisions; each of them ranks what is on offer by looking ahead, which is where its time goes.
"""

from __future__ import annotations

import math

import numpy as np

from slam_gym.association import RELOCATORS
from slam_gym.association.relocation.policy import SampledRelocation, greedy_relocation, relocator_from_policy
from slam_gym.bench.answers import Tolerance, attempt, without_sizes
from slam_gym.bench.records import Record, grouped, means, medians
from slam_gym.bench.report import Report
from slam_gym.scenarios import get_scenario
from slam_gym.simulation.relocation_problems import kidnap, map_world
from slam_gym.types import Relocator

METHODS: dict[str, Relocator] = {
    **RELOCATORS,
    "greedy": relocator_from_policy(greedy_relocation),
    "sampled": relocator_from_policy(SampledRelocation(), order="random"),
}
NEAR = Tolerance(0.3, math.radians(3.0))


def relocate_all(scenario_name: str, worlds: int, kidnappings: int, sizes: bool) -> list[Record]:
    """Every method on every scan of worlds 0, 1, … of the test split, from inside and outside in turns."""
    scenario, records = get_scenario(scenario_name), []
    for world in range(worlds):
        mapped = map_world(scenario, "test", world, "jcbb")
        locality, rng = mapped.locality("covisibility"), np.random.default_rng(world)
        for k in range(2 * kidnappings):
            drawn = kidnap(mapped, scenario, k % 2 == 0, rng)
            scan = drawn.scan if sizes else without_sizes(drawn.scan)
            for method, relocate in METHODS.items():
                answer, record = attempt(relocate, scan, mapped.landmarks, locality)
                right = NEAR.holds(answer.pose, drawn.pose)  # never outside, where the true pose is NaN
                record |= {"right": answer.accepted and right, "wrong": answer.accepted and not right}
                key = {"scenario": scenario_name, "sizes": sizes, "method": method}
                records.append({**key, "inside": drawn.inside, **record})
    return records


def summary(records: list[Record]) -> list[Record]:
    """Fractions and medians, inside and outside, of every method."""
    rows = []
    for key, group in grouped(records, "scenario", "sizes", "method"):
        inside, outside = ([record for record in group if record["inside"] is side] for side in (True, False))
        stray = {"wrong": "outside: wrong", "nodes": "outside: nodes", "ms": "outside: ms"}
        found = means(outside, "wrong") | medians(outside, "nodes", "ms")
        row = {**key, **means(inside, "right", "wrong"), **medians(inside, "nodes", "ms")}
        rows.append({**row, **{heading: found[name] for name, heading in stray.items()}})
    return rows


def run(
    report: Report,
    *,
    scenarios: tuple[str, ...] = ("office", "aliased", "hall"),
    worlds: int = 5,
    kidnappings: int = 20,
) -> None:
    """One row for each scenario, with and without sizes, and method.

    Arguments:
        scenarios: by name
        worlds: of the test split
        kidnappings: in each world, from inside, and as many from outside
    """
    records = []
    for name in scenarios:
        with report.part(name):
            records += relocate_all(name, worlds, kidnappings, True) + relocate_all(name, worlds, kidnappings, False)
    title = f"{worlds} worlds of the test split, {kidnappings} scans inside and outside of each"
    report.table(title, summary(records), "relocate")
