"""Every fault of a scan and of a hypothesis is refused by name; what is fine passes, as it is or made plain."""

import math
import re
from collections.abc import Callable
from dataclasses import fields, replace
from typing import get_args, get_type_hints

import gymnasium as gym
import numpy as np
import pytest

from slam_gym.association import RELOCATORS, random_sampling
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.navigation.explored_grid import ExploredGrid
from slam_gym.scenarios.scenario import KidnappingSpec, Scenario
from slam_gym.slam.atlas import AtlasSpec
from slam_gym.slam.places.recognition import RecognitionSpec
from slam_gym.slam.slam import SlamSpec
from slam_gym.types import UNPAIRED, Beams, Effort, Experience, Hypothesis, Landmarks, Locality, Odometry, Scan
from slam_gym.validation import LIMITS, check_hypothesis, check_scan, one_of
from slam_gym.world.physics import DynamicsSpec, RobotSpec
from slam_gym.world.sensor import BeamSpec, OdometrySpec, SensorSpec


def scan_with(covariance=None, **fields) -> Scan:
    """Three measurements, that of number 1 spoilt."""
    scan = Scan.from_points([[1, 0], [2, 1], [0, -3]], sigma=0.1)
    if covariance is not None:
        scan.covariances[1] = covariance
    return replace(scan, **fields)


# --- scans ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scan", "message"),
    [
        (scan_with(points=np.array([[1, 0], [np.nan, 1], [0, 0]])), "measurement 1: points are not finite"),
        (scan_with([[np.inf, 0], [0, 1]]), "measurement 1: covariance is not finite"),
        (scan_with([[1, 0.1], [0.2, 1]]), "measurement 1: covariance is not symmetric"),
        (scan_with([[-1, 0], [0, 1]]), "measurement 1: covariance is not PSD"),
        (scan_with([[1, 2], [2, 1]]), "measurement 1: covariance is not PSD"),
        (scan_with(np.diag([1e-12, 1e12])), "measurement 1: covariance has a condition number"),
    ],
)
def test_a_bad_measurement_is_named_with_its_fault(scan: Scan, message: str) -> None:
    with pytest.raises(ValueError, match=f"^Scan: {message}"):
        check_scan(scan)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"points": np.zeros((3, 3))}, r"Scan.points: shape \(3, 3\), expected \(3, 2\)"),
        ({"points": np.zeros((2, 2))}, r"Scan.covariances: shape \(3, 2, 2\), expected \(2, 2, 2\)"),
        ({"sizes": np.zeros(2)}, r"Scan.sizes: shape \(2,\), expected \(3,\)"),
        ({"points": [[1, 0], [2, 1], [0, 3]]}, "Scan.points: list, expected an array of float64"),
        ({"covariances": np.zeros((3, 2, 2), int)}, "Scan.covariances: int64, expected an array of float64"),
        ({"sizes": None}, "Scan.sizes: NoneType, expected an array of float64"),
        ({"kinds": np.zeros(3)}, "Scan.kinds: float64, expected an array of int64"),
    ],
)
def test_what_is_no_array_of_that_shape_is_named(fields, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        scan_with(**fields)


@pytest.mark.parametrize("turn", [0.0, 0.3, 2.0])
@pytest.mark.parametrize(("condition", "fine"), [(1e9, True), (1e11, True), (1e13, False), (1e15, False)])
def test_the_condition_number_decides_whatever_the_direction(turn: float, condition: float, fine: bool) -> None:
    c, s = np.cos(turn), np.sin(turn)
    C = np.array([[c, -s], [s, c]])
    covariance = C @ np.diag([1.0, 1.0 / condition]) @ C.T
    scan = scan_with(0.5 * (covariance + covariance.T))
    if fine:
        check_scan(scan)
    else:
        with pytest.raises(ValueError, match=r"condition number|not PSD"):
            check_scan(scan)


# --- hypotheses -------------------------------------------------------------------------------------------------------


def hypothesis(features, **fields) -> Hypothesis:
    return Hypothesis(features, 0.0, 0, Effort(), **fields)


@pytest.mark.parametrize(
    ("features", "message"),
    [
        (np.array([0]), r"hypothesis.features: int64 of shape \(1,\), expected \(3,\) signed integers"),
        (np.array([0.0, 1.0, 2.0]), "hypothesis.features: float64"),
        (np.array([0, 1, 2], np.uint8), "hypothesis.features: uint8"),
        ([0, 1, 2], "hypothesis.features: list, expected"),
        (np.array([0, 5, 1]), r"hypothesis.features\[1\]: 5, expected −1 … 4"),
        (np.array([0, 1, -2]), r"hypothesis.features\[2\]: -2, expected −1 … 4"),
        (np.array([3, UNPAIRED, 3]), r"hypothesis.features\[2\]: feature 3 is paired twice"),
    ],
)
def test_decisions_that_do_not_fit_are_named(features, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_hypothesis(hypothesis(features), 3, 5)


@pytest.mark.parametrize(
    "new", [np.array([True, False]), np.array([1, 0, 0]), np.array([True, False, False]), [False, True, False]]
)
def test_a_measurement_that_is_paired_or_not_there_cannot_be_new(new) -> None:
    with pytest.raises(ValueError, match=r"hypothesis.new: expected \(3,\) booleans"):
        check_hypothesis(hypothesis(np.array([0, UNPAIRED, 1]), new=new), 3, 5)


@pytest.mark.parametrize("answer", [None, np.array([0, 1, 2]), (np.array([0, 1, 2]), 0.0, 0, Effort())])
def test_what_is_no_hypothesis_is_named(answer) -> None:
    with pytest.raises(ValueError, match=rf"hypothesis: {type(answer).__name__}, expected a Hypothesis"):
        check_hypothesis(answer, 3, 5)


@pytest.mark.parametrize(
    "experience",
    ["much", Experience(1.0, math.nan, np.zeros(5)), Experience(1.0, 2.0, np.full(5, np.inf)), Experience(1, 2, None)],
)
def test_what_is_no_experience_is_named(experience) -> None:
    with pytest.raises(ValueError, match=r"hypothesis\.experience"):
        check_hypothesis(hypothesis(np.array([0, 1, 2]), experience=experience), 3, 5)


def test_what_fits_is_handed_back_as_it_is() -> None:
    for given in (
        hypothesis(np.array([4, UNPAIRED, 0]), new=np.array([False, True, False])),
        hypothesis(np.full(3, UNPAIRED)),
        hypothesis(np.array([3, 3, UNPAIRED]), exclusive=False),
    ):
        assert check_hypothesis(given, 3, 5) is given
    assert check_hypothesis(hypothesis(np.empty(0, np.int64)), 0, 0).pairings == 0


@pytest.mark.parametrize(
    "features",
    [
        np.array([2, -1, 0], np.int8),
        np.array([2, -1, 0], ">i4"),
        np.array([2, 7, -1, 7, 0, 7])[::2],
        np.frombuffer(np.array([2, -1, 0]).tobytes(), np.int64),
    ],
    ids=["int8", "another byte order", "every second", "read-only"],
)
def test_integers_of_another_sort_or_otherwise_laid_out_are_made_plain(features) -> None:
    checked = check_hypothesis(hypothesis(features), 3, 5).features
    assert type(checked) is np.ndarray and checked.dtype == np.dtype(np.int64)
    assert checked.tolist() == [2, -1, 0] and checked.flags.carray
    assert not np.shares_memory(checked, np.asarray(features))


# --- arguments --------------------------------------------------------------------------------------------------------


def test_an_argument_that_nobody_knows_is_refused_with_those_that_are_known() -> None:
    one_of("reward", "a_opt", ("a_opt", "d_opt", None))
    one_of("reward", None, ("a_opt", None))
    with pytest.raises(ValueError, match=r"^reward='money'; known: a_opt, d_opt, None$"):
        one_of("reward", "money", ("a_opt", "d_opt", None))
    with pytest.raises(ValueError, match=r"^reward='A-opt'; did you mean 'a_opt'\? known: a_opt, d_opt$"):
        one_of("reward", "A-opt", ("a_opt", "d_opt"))


def test_measurements_of_any_scale_within_the_bound_leave_a_map_positive_semi_definite():
    """Scales from 1e-12 to 1e12 m², each measurement up to the bound of the condition number; pairings are given."""
    rng, places = np.random.default_rng(0), np.array([[1.0, 0.0], [2.0, 1.0], [0.0, 3.0], [3.0, -2.0], [-2.0, 2.0]])
    for _ in range(40):
        slam_map, span = StochasticMap(), rng.uniform(0.0, 12.0)
        slam_map.add(Scan.from_points(places, sigma=10.0 ** rng.uniform(-3.0, 1.0)), np.arange(5))
        for _ in range(6):
            slam_map.predict(Odometry(np.array([0.1, 0.0, 0.01]), np.diag(10.0 ** rng.uniform(-span, span / 4, 3))))
            low = 10.0 ** rng.uniform(-span, span, 5)
            high = np.minimum(low * 10.0 ** rng.uniform(0.0, 11.5, 5), 1e12)
            turn = rng.uniform(0.0, 7.0, 5)
            axes = np.stack([np.stack([np.cos(turn), -np.sin(turn)], 1), np.stack([np.sin(turn), np.cos(turn)], 1)], 1)
            scales = np.stack([low, np.maximum(high, low)], 1)
            covariances = (axes * scales[:, None]) @ axes.swapaxes(1, 2)
            scan = Scan.from_points(places, 0.5 * (covariances + covariances.swapaxes(1, 2)))
            check_scan(scan)
            slam_map.update(scan, np.where(rng.random(5) < 0.6, np.arange(5), UNPAIRED))
            spread = np.sqrt(np.diag(slam_map.covariance))
            correlations = slam_map.covariance / np.outer(spread, spread)
            assert np.linalg.eigvalsh(correlations).min() > -1e-9


# --- settings ---------------------------------------------------------------------------------------------------------

SETTINGS = [
    SensorSpec, BeamSpec, OdometrySpec, RobotSpec, DynamicsSpec, KidnappingSpec, Scenario, MapSpec, SlamSpec,
    RecognitionSpec, AtlasSpec,
]  # fmt: skip
REQUIRED = {Scenario: {"name": "any", "generator": None, "budget": 1}}


@pytest.mark.parametrize("kind", SETTINGS)
def test_every_number_among_the_settings_has_limits(kind: type) -> None:
    hints = get_type_hints(kind)
    alternatives = {field.name: (hints[field.name], *get_args(hints[field.name])) for field in fields(kind)}
    numbers = {name for name, types in alternatives.items() if int in types or float in types}
    assert numbers == LIMITS[kind.__name__].keys()
    assert {known.__name__ for known in SETTINGS} == LIMITS.keys()


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in SETTINGS for name in LIMITS[kind.__name__]])
def test_a_number_beyond_its_limits_is_refused_by_name(kind: type, name: str) -> None:
    (least, greatest), hint = LIMITS[kind.__name__][name], get_type_hints(kind)[name]
    types = (hint, *get_args(hint))
    others = [*[least + 0.5] * (int in types), *[None] * (type(None) not in types)]
    for wrong in (least - 1.0, math.nan, True, "1", *others, *([] if greatest == math.inf else [2.0 * greatest + 1.0])):
        with pytest.raises(ValueError, match=rf"{kind.__name__}\.{name}="):
            kind(**(REQUIRED.get(kind, {}) | {name: wrong}))


@pytest.mark.parametrize(
    ("name", "value"),
    [("sensor.range_sigma", 1e4), ("sensor.bearing_sigma", 1e4), ("sensor.clutter", 1e9), ("sensor.range", 1e300),
     ("sensor.max_features", 10**9), ("beams.count", 2**62), ("beams.range", 1e300), ("robot.radius", 1e-6),
     ("dynamics.substeps", 10**6), ("odometry.floor", 1e200), ("grid_resolution", 1e-6), ("prior_sigma", 0.0),
     ("kidnapping.at", 0.0), ("kidnapping.at", 1.0)],
)  # fmt: skip
def test_absurd_settings_are_refused_as_the_environment_is_made(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"{name}: \w+\.\w+={re.escape(str(value))}: expected a (whole )?number from"):
        gym.make("slam_gym/Explore-v0", scenario="office-small", overrides={name: value})


def test_who_needs_more_raises_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LIMITS["SensorSpec"], "clutter", (0.0, 1e4))
    assert SensorSpec(clutter=5000.0).clutter == 5000.0


# --- arrays for compiled functions ------------------------------------------------------------------------------------

NO_BEAMS = Beams(np.zeros(4), np.ones(4), 6.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Odometry(np.zeros(2), np.zeros((3, 3))), r"Odometry.motion: shape \(2,\), expected \(3,\)"),
        (lambda: Odometry(np.zeros(3), np.zeros((2, 2))), r"Odometry.covariance: shape \(2, 2\)"),
        (lambda: Beams(np.zeros(4), np.ones(2), 6.0), r"Beams.ranges: shape \(2,\), expected \(4,\)"),
        (lambda: Locality(np.zeros(3), np.zeros(0, np.int64)), "Locality.starts: float64, expected an array of int64"),
        (lambda: ExploredGrid(np.ones(4) * [-1, -1, 1, 1]).integrate(np.zeros(1), NO_BEAMS), r"pose: expected \(3,\)"),
    ],
)
def test_arrays_that_compiled_code_would_read_beyond_are_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize("search", RELOCATORS.values())
@pytest.mark.parametrize("count", [0, 1.5])
def test_every_search_without_a_prior_refuses_a_limit_that_is_no_count(search, count):
    scan, limit = scan_with(), "tries" if search is random_sampling else "node_limit"
    with pytest.raises(ValueError, match=limit):
        search(scan, Landmarks.from_points(scan.points, sigma=0.1), **{limit: count})
