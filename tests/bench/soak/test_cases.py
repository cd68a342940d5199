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
    assert all(50 <= c.ticks <= 100 for c in cases) and "case 7: Associate" in str(cases[7])


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
