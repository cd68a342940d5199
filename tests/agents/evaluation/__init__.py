"""The settings of logs made by hand; results without their times."""

from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.slam.slam import SlamSpec

SPEC = SlamSpec(MapSpec(unconfirmed_age=10), reach=8.0, new_confidence=1.0 - 1e-6)


def timeless(frame) -> str:
    """Results without what depends on how busy the machine is, made comparable."""
    drop = ["seconds", "ticks_per_second", "microseconds", "microseconds_p99", "step_microseconds"]
    return frame.drop(columns=drop, errors="ignore").to_csv(index=False)
