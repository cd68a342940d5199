"""`slam-gym demo` and `slam-gym slam`: what they say and leave; the names that `list` knows."""

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from agents import demo, slam
from slam_gym import ASSOCIATORS
from slam_gym import __main__ as commands
from tests.agents import typed


def test_the_demo_maps_one_drive_by_each_associator_and_leaves_a_picture(tmp_path):
    options = ("--scenario", "office-small", "--seed", 0, "--output", tmp_path / "demo.png")
    result = typed(demo.app, *options, "--associators", "nearest_neighbour", "true_association")
    assert result.exit_code == 0, result.output
    assert result.stdout.count("map error") == 2 and f"picture: {tmp_path / 'demo.png'}" in result.stdout
    assert Image.open(tmp_path / "demo.png").width > 1000


def test_a_table_becomes_a_map_a_path_and_a_picture(tmp_path):
    posts = np.array([[8.0, 1.0], [6.0, -2.0], [9.0, 3.0]])
    rows = ["time,forward,lateral,turn,x,y"]
    for step in range(8):
        for i, (x, y) in enumerate(posts - [0.5 * step, 0.0]):
            rows.append(f"{step},{'0.5,0,0' if step and not i else '0,0,0' if not i else ',,'},{x},{y}")
    (tmp_path / "mine.csv").write_text("\n".join(rows))
    result = typed(slam.app, tmp_path / "mine.csv", "--output", tmp_path / "out")
    assert result.exit_code == 0, result.output
    table = pd.read_csv(tmp_path / "out" / "mine.map.csv").sort_values("x")
    assert np.allclose(table[["x", "y"]], posts[np.argsort(posts[:, 0])], atol=0.1) and (table["sightings"] == 8).all()
    assert (table["map"] == 0).all()
    assert np.loadtxt(tmp_path / "out" / "mine.path.tum")[-1, 1] == pytest.approx(3.5, abs=0.05)
    assert Image.open(tmp_path / "out" / "mine.png").width > 500


def test_a_log_of_two_scans_says_nothing_of_its_sigmas(tmp_path):
    (tmp_path / "short.csv").write_text("time,forward,lateral,turn,x,y\n0,0,0,0,3,1\n1,0,0,0,3.11,1.11\n")
    result = typed(slam.app, tmp_path / "short.csv", "--associator", "marginal", "--output", tmp_path)
    assert result.exit_code == 0 and "sigmas" not in result.output


@pytest.mark.parametrize("claimed", [0.05, 0.15])
def test_a_map_far_from_the_origin_is_right_and_sigmas_that_are_too_small_are_told(tmp_path, claimed):
    rng, posts = np.random.default_rng(0), np.array([[x, y] for y in (2.0, 9.0, 16.0) for x in (3.0, 8.0, 13.0, 18.0)])
    rows = ["time,forward,lateral,turn,x,y,sigma_x,sigma_y"]
    for step in range(30):
        for i, (x, y) in enumerate(posts - [0.2 * step, 10.0] + rng.normal(0.0, 0.15, (12, 2))):
            rows.append(f"{step},{',,' if i else '0.2,0,0' if step else '10000,5000,0'},{x},{y},{claimed},{claimed}")
    (tmp_path / "cost_$5_$6.csv").write_text("\n".join(rows))
    result = typed(slam.app, tmp_path / "cost_$5_$6.csv", "--output", tmp_path)
    assert result.exit_code == 0, result.output
    assert ("the sigmas are probably too small" in result.output) == (claimed < 0.15)
    table = pd.read_csv(tmp_path / "cost_$5_$6.map.csv")
    if claimed == 0.15:
        found = table.sort_values(["y", "x"], key=lambda places: places.round())[["x", "y"]]
        np.testing.assert_allclose(found, posts + np.array([10000, 4990]), atol=0.3)


def test_a_log_that_is_not_there_is_named(tmp_path):
    result = typed(slam.app, tmp_path / "mine.csv")
    assert result.exit_code == 2 and f"error: {tmp_path / 'mine.csv'}: not there" in result.stderr


@pytest.mark.parametrize(
    "listed", ["associators jcbb", "relocators gcbb", "scenarios drift-2", "drivers lawnmower", "recordings dlr"]
)
def test_names_are_listed_one_a_line(listed):
    topic, name = listed.split()
    names = typed(commands.app, "list", topic).output.split()
    assert name in names and (topic != "associators" or names == list(ASSOCIATORS))
