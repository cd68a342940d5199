"""`python -m slam_gym.bench NAME …`: the benchmarks behind the figures in the README."""

from __future__ import annotations

import importlib
import sys

_MODULES = {
    "corridor": "consistency.corridor",
    "step": "speed.step",
    "jcbb": "speed.jcbb",
    "prior": "speed.prior",
    "update": "speed.update",
    "locality": "locality.locality",
    "associate": "feature_index.associate",
    "relocate": "speed.relocate",
    "recordings": "recordings.recordings",
    "consistency": "consistency.consistency",
    "sight": "speed.sight",
}

BENCHMARKS = {
    "corridor": "reference experiment: associators in the corridor, 40 seeds, beside the bands expected of them",
    "step": "Explore-v0 steps per second, against map size, and where the time of a step goes",
    "jcbb": "JCBB at loop closure against scipy's linear assignment on the same gated problem",
    "prior": "all searches with a prior at loop closure: exact scans, recall, precision, time",
    "update": "joint EKF update against one symmetric rank-20 product",
    "locality": "relocation under each locality against the bound of the source; --tracking: what it saves JCBB",
    "associate": "relocation by the feature index: time, success beside exact cliques, maps from SLAM",
    "relocate": "kidnapped robots of Relocate-v0 found again: searches and policies, success against nodes",
    "recordings": "relocation on Victoria Park and MR.CLAM: right, wrong, none against pairings and locality",
    "consistency": "standard EKF, first-estimate Jacobians, local maps on long loops: ANEES, duplicates, error, time",
    "sight": "line of sight on small and large floors; cost of physics and sensors",
}


def main(argv: list[str]) -> int:
    """Run the benchmark named first with the remaining arguments; 2 and the list of names where there is none such."""
    if not argv or argv[0] not in BENCHMARKS:
        lines = "\n".join(f"  {name:10s} {text}" for name, text in BENCHMARKS.items())
        print(f"usage: python -m slam_gym.bench NAME [options]   (NAME --help lists them)\n{lines}", file=sys.stderr)
        return 0 if argv and argv[0] in ("-h", "--help") else 2
    importlib.import_module(f"slam_gym.bench.{_MODULES[argv[0]]}").main(argv[1:])
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
