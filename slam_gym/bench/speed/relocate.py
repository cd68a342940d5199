"""Kidnapped robots found again: searches and policies on the episodes of `Relocate-v0`, success against nodes.

Every method is given the same scans, from inside and outside of maps that a robot made by SLAM with JCBB, and the
locality by covisibility. `right`: believed, and the pose within .3 m and 3° of the truth in the map; `wrong`: believed,
and elsewhere; the rest gave no answer. Outside, whatever is believed is wrong. Policies are `greedy` (one try, always
the candidate with most support) and `sampled` (random tries until one is believed), K = 8 candidates on offer. Nodes of
a policy are decisions; each of them ranks what is on offer by looking ahead, which is where its time goes.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass, replace

import numpy as np

from slam_gym.association import RELOCATORS
from slam_gym.association.relocation.policy import SampledRelocation, greedy_relocation, relocator_from_policy
from slam_gym.geometry import relative
from slam_gym.scenarios import get_scenario
from slam_gym.simulation.relocation_problems import Kidnapped, kidnap, map_world
from slam_gym.types import Array, Relocation, Relocator, Scan

METHODS: dict[str, Relocator] = {
    **RELOCATORS,
    "greedy": relocator_from_policy(greedy_relocation),
    "sampled": relocator_from_policy(SampledRelocation(), order="random"),
}


@dataclass(frozen=True)
class Settings:
    """What is run."""

    scenarios: tuple[str, ...]
    worlds: int  # of the test split
    kidnappings: int  # in each, from inside and as many from outside


def main(argv: list[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="slam_gym.bench relocate", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenarios", nargs="+", default=["office", "aliased", "hall"])
    parser.add_argument("--worlds", type=int, default=5)
    parser.add_argument("--kidnappings", type=int, default=20)
    given = parser.parse_args(argv)
    settings = Settings(tuple(given.scenarios), given.worlds, given.kidnappings)
    print(f"{settings.worlds} worlds of the test split, {settings.kidnappings} scans inside and outside of each\n")
    head = f"{'scenario':10s}{'sizes':7s}{'method':10s}{'right':>7s}{'wrong':>7s}{'nodes':>8s}{'ms':>7s}"
    print(f"{head}{'| wrong':>9s}{'nodes':>8s}{'ms':>7s}  (outside)")
    for name in settings.scenarios:
        for sizes in (True, False):
            for method, found in run(settings, name, sizes).items():
                inside, outside = (found[found[:, 0] == side] for side in (1.0, 0.0))
                right, wrong = inside[:, 1].mean(), inside[:, 2].mean()
                nodes, ms = np.median(inside[:, 3:5], axis=0)
                line = f"{name:10s}{'yes' if sizes else 'no':7s}{method:10s}"
                line += f"{right:7.2f}{wrong:7.2f}{nodes:8.0f}{ms:7.1f}"
                nodes, ms = np.median(outside[:, 3:5], axis=0)
                print(f"{line}{outside[:, 2].mean():9.2f}{nodes:8.0f}{ms:7.1f}", flush=True)


def run(settings: Settings, name: str, sizes: bool) -> dict[str, Array]:
    """Of each method, for every scan: inside, right, wrong, nodes, milliseconds (s, 5)."""
    scenario = get_scenario(name)
    found: dict[str, list[list[float]]] = {method: [] for method in METHODS}
    for world in range(settings.worlds):
        mapped = map_world(scenario, "test", world, "jcbb")
        locality, rng = mapped.locality("covisibility"), np.random.default_rng(world)
        for k in range(2 * settings.kidnappings):
            drawn = kidnap(mapped, scenario, k % 2 == 0, rng)
            scan = drawn.scan if sizes else without_sizes(drawn.scan)
            for method, relocate in METHODS.items():
                start = time.perf_counter()
                answer = relocate(scan, mapped.landmarks, locality)
                taken = 1e3 * (time.perf_counter() - start)
                found[method].append([drawn.inside, *judge(drawn, answer), answer.effort.nodes, taken])
    return {method: np.array(rows, np.float64) for method, rows in found.items()}


def judge(drawn: Kidnapped, answer: Relocation) -> tuple[bool, bool]:
    """(right, wrong); neither where nothing is believed."""
    if not answer.accepted:
        return False, False
    error = relative(drawn.pose, answer.pose)  # NaN outside, which is never near
    right = math.hypot(error[0], error[1]) <= 0.3 and abs(float(error[2])) <= math.radians(3.0)
    return right, not right


def without_sizes(scan: Scan) -> Scan:
    """The same scan, its sizes unknown."""
    unknown = np.full(len(scan), np.nan)
    return replace(scan, sizes=unknown, size_variances=unknown.copy())
