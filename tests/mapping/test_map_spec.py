"""Settings of the map: which are refused."""

import pytest

from slam_gym.mapping.map_spec import MapSpec


@pytest.mark.parametrize(
    "field",
    [
        {"confidence": 1.0},
        {"confidence": 0.0},
        {"unconfirmed_age": -1},
        {"iterations": 0},
        {"error": "none"},
        {"settled": -1.0},
        {"confirmations": 0},
    ],
)
def test_settings_out_of_range_are_refused(field: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(field))):
        MapSpec(**field)
