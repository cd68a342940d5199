"""The step in one compiled call is the page's step: twins, one of which is asked by a stranger in the same words."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from slam_gym.association import jcbb, nearest_neighbour, singles
from slam_gym.mapping.map_state import state_of
from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.slam.atlas import AtlasSpec
from slam_gym.slam.relocate import relocate_by
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import NO_ID, Associator, Scan, SlamStep
from tests.slam.rings import drive, ring_of_landmarks, view_from

SPEC = SlamSpec(MapSpec(unconfirmed_age=20), reach=12.0)
NEVER_AMBIGUOUS = AtlasSpec(max_accidental_matches=1e9)
_ASKED = ("joint", "local", "view")  # of a prediction, which hold for the moment that it was made at


def stranger(associate: Associator) -> Associator:
    """The same, so that no step knows it."""
    return lambda scan, prediction: associate(scan, prediction)


def told(step: SlamStep) -> dict[str, Any]:
    """All that a step tells, but the time that a relocation took."""
    out = {name: getattr(step, name) for name in ("ids", "created", "removed", "returned")}
    for part in (step.prediction, step.hypothesis):
        out |= {field.name: getattr(part, field.name) for field in fields(part) if field.name not in _ASKED}
    out["effort"] = replace(out["effort"], seconds=0.0)
    for name in ("posterior", "experience"):
        if (part := getattr(step.hypothesis, name)) is not None:
            del out[name]
            out |= {f"{name}.{field.name}": getattr(part, field.name) for field in fields(part)}
    return out


def assert_twins(one: Slam, other: Slam, log: Any, associate: Associator) -> None:
    """Two that are given the same log end every step alike, and with the same map, to the last bit."""
    page = stranger(associate)
    for odometry, scan, *_ in log:
        ours, theirs = told(one.step(odometry, scan, associate)), told(other.step(odometry, scan, page))
        assert ours.keys() == theirs.keys()
        for name, value in ours.items():
            np.testing.assert_array_equal(value, theirs[name], err_msg=name)
        assert (one.lost, one.doubted, one.map.n) == (other.lost, other.doubted, other.map.n)
    ours, theirs = state_of(one.map), state_of(other.map)
    np.testing.assert_array_equal(ours.mean, theirs.mean)
    np.testing.assert_array_equal(ours.covariance, theirs.covariance)
    np.testing.assert_array_equal(ours.columns.last_seen, theirs.columns.last_seen)
    for edges, others in zip(one.covisibility.edges(), other.covisibility.edges()):
        np.testing.assert_array_equal(edges, others)


def log_of(seed: int, carried_at: int | None = None, steps: int = 220, in_pairs: bool = False) -> Any:
    """Round the block, among clutter: every third scan has a measurement of nothing."""
    rng = np.random.default_rng(seed)
    landmarks = ring_of_landmarks(rng)
    if in_pairs:
        landmarks = np.concatenate([landmarks, landmarks + 0.5])
    for number, (odometry, scan, *rest) in enumerate(drive(landmarks, rng, steps, 0.02, carried_at).steps):
        if number % 3 == 0:
            more = Scan.from_points(rng.uniform(-4.0, 4.0, (1, 2)), sigma=0.05)
            scan = Scan(
                *(np.concatenate([getattr(part, field.name) for part in (scan, more)]) for field in fields(Scan))
            )
        yield odometry, scan, *rest


ONE_PASS = MapSpec(right_invariant=False, iterations=1)


@pytest.mark.parametrize("associate", [jcbb, nearest_neighbour, singles])
@pytest.mark.parametrize(
    "spec",
    [
        SPEC,
        replace(SPEC, reach=None, locality=False, new_confidence=0.9999, map=ONE_PASS),
        replace(SPEC, map=MapSpec(confirmations=3, unconfirmed_age=5)),
        replace(SPEC, map=MapSpec(second_order=False, unconfirmed_age=None)),
    ],
)
def test_slam_is_the_page_s(spec: SlamSpec, associate: Associator) -> None:
    assert_twins(Slam(spec), Slam(spec), log_of(1, steps=60), associate)


@pytest.mark.parametrize("view", [None, view_from])
@pytest.mark.parametrize("ambiguous", [0.1, 1e9])
def test_an_atlas_that_is_lost_and_closes_loops_is_the_page_s(ambiguous: float, view: Any) -> None:
    one, other = (
        Slam(SPEC, view, relocate=relocate_by("gcbb"), atlas=AtlasSpec(max_accidental_matches=ambiguous))
        for _ in range(2)
    )
    assert_twins(one, other, log_of(3, carried_at=120), jcbb)
    assert one.map.n > 20 and len(one.maps) == len(other.maps)


def test_so_is_one_that_holds_back_what_may_be_chance() -> None:
    one, other, plain = (
        Slam(replace(SPEC, max_chance_probability=c), view_from, relocate=relocate_by("gcbb"), atlas=NEVER_AMBIGUOUS)
        for c in (0.05, 0.05, 1.0)
    )
    assert_twins(one, other, log_of(3, steps=330, in_pairs=True), jcbb)
    for odometry, scan, *_ in log_of(3, steps=330, in_pairs=True):
        plain.step(odometry, scan, jcbb)
    assert not np.array_equal(plain.map.pose, one.map.pose)  # something was held back


def test_what_is_held_back_starts_features_where_it_is_told_to() -> None:
    believing, waiting, anew = (
        Slam(
            replace(SPEC, max_chance_probability=c, start_features_from_rejected=new),
            view_from,
            relocate=relocate_by("gcbb"),
            atlas=NEVER_AMBIGUOUS,
        )
        for c, new in ((1.0, False), (0.05, False), (0.05, True))
    )
    for odometry, scan, *_ in log_of(3, steps=330, in_pairs=True):
        paired, held, begun = (slam.step(odometry, scan, jcbb) for slam in (believing, waiting, anew))
        if (paired.ids != held.ids).any():
            break
        np.testing.assert_array_equal(begun.ids, held.ids)
    back = (held.ids == NO_ID) & (paired.ids != NO_ID)
    assert back.any() and begun.created[back].any() and not held.created[back].any()
    assert (begun.ids == held.ids)[~begun.created].all()


def test_so_is_one_that_relocates_only() -> None:
    one, other = (Slam(SPEC, relocate=relocate_by("gcbb")) for _ in range(2))
    assert_twins(one, other, log_of(5, carried_at=120), jcbb)
    assert one.relocations == other.relocations
