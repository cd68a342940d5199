"""Scenarios changed by names and plain values."""

import json
import math
from dataclasses import replace

import pytest

from slam_gym.scenarios import KidnappingSpec, get_scenario, overridden, parse_override

OFFICE = get_scenario("office")


def test_fields_are_changed_at_any_depth_and_nothing_else_is() -> None:
    overrides = {
        "sensor.range": 4,
        "wall_compass": True,
        "odometry.turn_per_metre": 0.1,
        "dynamics.people": 3,
        "budget": 500,
        "slam.map.confidence": 0.95,
        "slam.map.unconfirmed_age": None,
        "slam.new_confidence": 0.5,
        "generator.rooms": 4,
        "generator.contents.pillars": 2,
    }
    changed = overridden(OFFICE, json.loads(json.dumps(overrides)))
    contents = replace(OFFICE.generator.contents, pillars=2.0)
    assert changed == replace(
        OFFICE,
        sensor=replace(OFFICE.sensor, range=4.0),
        wall_compass=True,
        odometry=replace(OFFICE.odometry, turn_per_metre=0.1),
        dynamics=replace(OFFICE.dynamics, people=3),
        budget=500,
        slam=replace(
            OFFICE.slam, map=replace(OFFICE.slam.map, confidence=0.95, unconfirmed_age=None), new_confidence=0.5
        ),
        generator=replace(OFFICE.generator, rooms=4, contents=contents),
    )
    assert isinstance(changed.sensor.range, float) and hash(changed) != hash(OFFICE)
    assert overridden(OFFICE, {}) == OFFICE == get_scenario("office")


def test_what_may_be_none_can_be_switched_on_and_off() -> None:
    assert overridden(OFFICE, {"kidnapping.at": 0.3}).kidnapping == KidnappingSpec(at=0.3)
    assert overridden(get_scenario("kidnapped"), {"kidnapping": None}).kidnapping is None


def test_the_order_of_changes_does_not_matter() -> None:
    changes = [("sensor.min_range", 7.0), ("sensor.range", 9.0)]  # by itself the first would be refused
    assert overridden(OFFICE, dict(changes)) == overridden(OFFICE, dict(reversed(changes)))


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (
            {"sensor.rnage": 4.0},
            r"'sensor.rnage': .*no such field in 'sensor'; did you mean 'range'\? known: range, min",
        ),
        ({"": 4.0}, r"'': there is no such field"),
        ({3: 4}, "override 3: expected the name of a field"),
        ({"sensor": "good"}, r"'sensor': expected the name of a field in it, sensor\.…, got 'good'"),
        ({"sensor.range.x": 4.0}, r"'sensor.range': has no fields"),
        ({"kidnapping": None, "kidnapping.at": 0.5}, r"'kidnapping': is given a value and fields"),
        ({"budget": True}, r"'budget': expected a whole number, got True"),
        ({"sensor.range": False}, r"'sensor.range': expected a finite number, got False"),
        ({"sensor.range": math.nan}, r"'sensor.range': expected a finite number, got nan"),
        ({"sensor.range": 10**400}, r"'sensor.range': expected a finite number"),
        ({"wall_compass": 1}, r"'wall_compass': expected true or false, got 1"),
        ({"sensor": {"range": 4.0}}, r"'sensor': expected a bool, a number, a string or None"),
        ({"sensor.range": -4.0}, r"sensor.range: SensorSpec.range=-4.0: expected a number from 0.01"),
        ({"slam.map.confidence": 2.0}, r"slam.map.confidence: MapSpec.confidence=2.0: expected a number"),
    ],
)
def test_what_cannot_be_is_refused_by_name(overrides, said) -> None:
    with pytest.raises(ValueError, match=said):
        overridden(OFFICE, overrides)


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("sensor.range=4", "sensor.range", 4),
        ("sensor.range=4.5e0", "sensor.range", 4.5),
        (" wall_compass =true", "wall_compass", True),
        ("slam.new_confidence=null", "slam.new_confidence", None),
        ("name=a = b", "name", "a = b"),
        ("name=[1]", "name", "[1]"),
        ("name=", "name", ""),
    ],
)
def test_a_command_line_gives_names_and_values(text, name, value) -> None:
    found = parse_override(text)
    assert found == (name, value) and type(found[1]) is type(value)


@pytest.mark.parametrize("text", ["", "sensor.range", "=4", " =4"])
def test_a_command_line_without_a_name_and_a_value_is_refused(text) -> None:
    with pytest.raises(ValueError, match=r"expected NAME=VALUE, such as sensor\.range=4"):
        parse_override(text)
