"""`python -m slam_gym.bench NAME …`: the benchmarks behind the published figures."""

from __future__ import annotations

import sys

from slam_gym.bench.runner import main

if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
