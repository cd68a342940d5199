"""The plan of the training that ships."""

import pytest

from agents.learning.associator.reproduction import SHARES, Plan, sources, weighed
from agents.learning.associator.sources import HIDDEN, VIEWS, VIEWS_AND_SIZES
from tests.agents.learning.associator.test_decisions import answered


def test_no_world_is_both_trained_on_and_held_out():
    train, held_out = sources(Plan())
    assert len(set(train)) == len(train) and not {(s.name, s.world) for s in train} & {
        (s.name, s.world) for s in held_out
    }
    assert {s.hidden for s in held_out} == set(HIDDEN) and {s.hidden for s in train} == {
        *HIDDEN,
        VIEWS,
        VIEWS_AND_SIZES,
    }
    assert {s.kind for s in train} == set(SHARES) and {s.kind for s in held_out} == {"level"}


def test_kinds_of_sources_have_their_shares():
    scans = [answered(seed)[3] for seed in range(6)]
    found = weighed({"level": scans[:1], "loop": scans[1:]})
    level, loop = found[0].weight, sum(d.weight for d in found[1:])
    assert level / loop == pytest.approx(SHARES["level"] / SHARES["loop"]) and level + loop == pytest.approx(6.0)
