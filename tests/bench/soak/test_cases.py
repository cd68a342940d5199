"""Cases of the soak go round everything there is, and can be made."""

import numpy as np
import pytest

from slam_gym.association import ASSOCIATORS, RELOCATORS
from slam_gym.bench.soak.cases import EXTREMES, case
from slam_gym.scenarios import SCENARIOS, get_scenario


def test_they_follow_from_seed_and_number_and_go_round_everything():
    cases = [case(k, 0, 100) for k in range(640)]
    assert cases[7] == case(7, 0, 100) != case(7, 1, 100)
    assert {c.env for c in cases} == {"Explore", "Associate", "Relocate"}
    assert {c.scenario for c in cases} == set(SCENARIOS)
    for env in ("Explore", "Associate"):
        assert {c.extreme for c in cases if c.env == env} == set(EXTREMES)
    explore = [c.options for c in cases if c.env == "Explore"]
    assert {o["associator"] for o in explore} == set(ASSOCIATORS)
    assert {o["relocation"] for o in explore} == {None, *RELOCATORS}
    assert "case 7: Associate" in str(cases[7])


def test_episodes_are_long_where_a_tick_is_short_and_never_longer_than_asked_for():
    cases = [case(k, 0, 1000) for k in range(640)]
    explore = {name: [c.ticks for c in cases if c.env == "Explore" and c.extreme == name] for name in EXTREMES}
    assert all(500 <= ticks <= 1000 for ticks in explore["as it is"] + explore["no noise"])
    assert all(50 <= ticks <= 100 for ticks in explore["all at once"])
    assert all(20 <= c.ticks <= 250 for c in cases if c.env != "Explore")
    assert case(7, 0, 10).ticks == 10


@pytest.mark.parametrize("name", EXTREMES)
def test_extremes_change_what_they_say(name):
    office = get_scenario("office")
    changed = EXTREMES[name](office)
    assert (changed == office) == (name == "as it is")
    if name == "noise x 20":
        assert changed.odometry.forward == 20 * office.odometry.forward
    if name == "floor of 200 m":
        x0, _, x1, _ = changed.generator(np.random.default_rng(0)).bounds
        assert 180 < x1 - x0 < 260
