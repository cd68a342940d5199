"""Settings of the map: what they stand for where nothing is said, and which are refused."""

import pytest

from slam_gym.mapping.map_spec import MapSpec


@pytest.mark.parametrize(
    ("spec", "passes", "right_invariant"),
    [
        (MapSpec(), 3, True),
        (MapSpec(first_estimate_jacobians=True), 1, False),
        (MapSpec(iterations=2, error="ordinary"), 2, False),
    ],
)
def test_what_is_not_said_follows_from_the_rest(spec: MapSpec, passes: int, right_invariant: bool) -> None:
    assert spec.passes == passes and spec.right_invariant == right_invariant


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
