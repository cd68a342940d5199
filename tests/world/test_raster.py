"""Occupancy images become floor plans: exact where the image is, drivable where the building is real."""

import gzip

import numpy as np
import pytest

from slam_gym.scenarios import SCENARIOS, floor_budget
from slam_gym.world.draft import Contents
from slam_gym.world.floor_plan import FloorPlanError, Kind
from slam_gym.world.floor_plan_file import load_floor_plan
from slam_gym.world.generators import OfficeGenerator
from slam_gym.world.raster import from_raster, thinned
from slam_gym.world.reachability import free_cells, reachable
from tests.world.test_floor_plan_file import PIXEL, blank

cv2 = pytest.importorskip("cv2", reason="needs the extra `maps`")

KTH = ("50010535_PLAN1", "50037764_PLAN1", "50052748", "50052752")


def drawn(plan):
    """Image and room labels of a generated plan, free where a pixel's middle is, and their lower left corner [m]."""
    low, high = plan.bounds[:2] - 1.0, plan.bounds[2:] + 1.0
    width, height = np.ceil((high - low) / PIXEL).astype(int)
    x, y = low[0] + (np.arange(width) + 0.5) * PIXEL, low[1] + (height - np.arange(height) - 0.5) * PIXEL
    middles = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    labels = np.zeros(len(middles), dtype=np.int32)
    for i, room in enumerate(plan.rooms):
        labels[room.contains(middles)] = i + 1
    free = labels > 0
    for door in plan.doors:
        upright = door.rooms[0] != "corridor"
        half = np.array([0.101, door.width / 2] if upright else [door.width / 2, 0.101])
        free |= (np.abs(middles - door.position) <= half).all(axis=1)
    return np.where(free, 255, 0).astype(np.uint8).reshape(height, width), labels.reshape(height, width), low


def matched(found, true, tolerance):
    """Share of `found` within `tolerance` [m] of one of `true`."""
    return np.mean(np.hypot(*(found[:, None] - true).T).min(axis=0) <= tolerance)


def test_a_rectangle_is_exact_and_the_upper_row_lies_at_the_top():
    image = blank(100, 140)
    image[10:30, 10:40] = 0  # upper left corner of the image
    plan = from_raster(image, PIXEL)
    expected = np.array([[2.0, 4.5], [6.5, 4.5], [6.5, 0.5], [0.5, 0.5], [0.5, 3.5], [2.0, 3.5]])
    assert len(plan.walls) == len(plan.features) == 6
    for found in (plan.features.positions, plan.walls[:, :2]):
        np.testing.assert_allclose(found[np.lexsort(found.T)], expected[np.lexsort(expected.T)], atol=1e-9)
    assert plan.rooms[0].area == pytest.approx(6.0 * 4.0 - 1.5 * 1.0)
    assert set(plan.features.kinds) == {Kind.CORNER}


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("labelled", [True, False])
def test_a_drawn_office_gives_back_its_rooms_doors_and_corners(seed, labelled):
    truth = OfficeGenerator(contents=Contents(pillars=0.0, furniture=0.0))(np.random.default_rng(seed))
    image, labels, low = drawn(truth)
    plan = from_raster(image, PIXEL, valid=labels if labelled else None, origin=tuple(low))
    assert matched(plan.features.positions, truth.features.positions, 1.5 * PIXEL) > 0.98
    apart = 0.3 + 1.5 * PIXEL  # corners closer than 0.3 m are represented by one of them
    blocks = truth.features.sizes < 0.45  # pilasters, of which these images were drawn without
    assert matched(truth.features.positions[~blocks], plan.features.positions, apart) > 0.98
    found, true = (len(reachable(each, free_cells(each, 0.2))) for each in (plan, truth))
    assert found == pytest.approx(true, rel=0.04)
    if not labelled:
        assert len(plan.rooms) == 1 and not plan.doors
        return
    areas = sorted(room.area for room in truth.rooms)
    np.testing.assert_allclose(sorted(room.area for room in plan.rooms), areas, rtol=0.03)
    assert len(plan.doors) == len(truth.doors)
    for door in plan.doors:
        nearest = min(truth.doors, key=lambda other: np.hypot(*(other.position - door.position)))
        np.testing.assert_allclose(door.position, nearest.position, atol=2 * PIXEL)
        assert door.width == pytest.approx(nearest.width, abs=3 * PIXEL)
    jamb = plan.features.kinds == Kind.DOOR_JAMB
    true_jambs = truth.features.positions[truth.features.kinds == Kind.DOOR_JAMB]
    assert matched(plan.features.positions[jamb], true_jambs, 1.5 * PIXEL) > 0.9
    assert matched(true_jambs, plan.features.positions[jamb], apart) > 0.98


def test_islands_become_pillars_walls_keep_corners_specks_vanish():
    image = blank()
    cv2.circle(image, (40, 50), 5, 0, -1)
    image[48:52, 70:110] = 0  # a free-standing wall of 2 m × 0.2 m
    image[30, 90] = 0
    plan = from_raster(image, PIXEL)
    pillar = plan.features.kinds == Kind.PILLAR
    np.testing.assert_allclose(plan.features.positions[pillar], [[40.5 * PIXEL, (100 - 50.5) * PIXEL]], atol=PIXEL)
    assert plan.features.sizes[pillar][0] == pytest.approx(11 * PIXEL, abs=1.5 * PIXEL)
    ends = np.array([[70, 50], [110, 50]]) * PIXEL
    assert matched(ends, plan.features.positions[~pillar], 3 * PIXEL) == 1.0
    assert len(plan.features) == 4 + 1 + 2


@pytest.fixture(scope="module")
def floors(data_dir):
    return {name: load_floor_plan(data_dir / "kth_floorplans" / f"{name}_occ_map.npy.gz", 0.1) for name in KTH}


@pytest.mark.parametrize("name", KTH)
def test_real_floors_can_be_driven(name, floors, data_dir):
    plan = floors[name]
    images = []
    for kind in ("occ_map", "valid_space"):
        with gzip.open(data_dir / "kth_floorplans" / f"{name}_{kind}.npy.gz") as file:
            images.append(np.load(file))
    drawn = np.count_nonzero((images[0] > 0) & (images[1] > 0)) * 0.01  # [m²]
    area = sum(room.area for room in plan.rooms)
    assert 0.86 * drawn < area < 1.01 * drawn  # two floors have wings that no door joins to the rest
    assert len(plan.rooms) >= 0.88 * (len(np.unique(images[1])) - 1)
    cells = reachable(plan, free_cells(plan, 0.2))
    assert sum(room.area for room in plan.rooms if room.contains(cells).any()) >= 0.95 * area
    assert len(plan.doors) >= len(plan.rooms) - 15
    assert 0.06 < len(plan.features) / area < 0.3
    assert name != "50052748" or 6_000 < floor_budget(plan, SCENARIOS["building"]) < 7_500
    assert len(thinned(plan.features.positions, np.zeros(len(plan.features)))) == len(plan.features)


def test_a_corridor_round_a_solid_block_is_the_floor_and_not_the_block():
    image = np.zeros((280, 480), np.uint8)
    image[10:270, 10:470] = 255
    image[30:250, 30:450] = 0
    plan = from_raster(image, 0.1)
    assert plan.rooms[0].area == pytest.approx(46.0 * 26.0 - 42.0 * 22.0)
    x, y = reachable(plan, free_cells(plan, 0.2)).T
    assert len(x) and ((x < 3.0) | (x > 45.0) | (y < 3.0) | (y > 25.0)).all()


@pytest.mark.parametrize("angle", [11.0, 33.0, 45.0])
def test_an_oblique_wall_of_one_pixel_is_a_wall(angle):
    image, turn = blank(300, 300), np.deg2rad(angle)
    along = 100.0 * np.array([np.cos(turn), np.sin(turn)])  # it ends within the room
    ends = (np.array([150.0, 150.0]) + [[-1.0], [1.0]] * along).round().astype(int).tolist()
    cv2.line(image, ends[0], ends[1], 0, 1, cv2.LINE_8)
    plan = from_raster(image, 0.1)
    x, y = (reachable(plan, free_cells(plan, 0.2)) - 15.0).T
    on_line = np.abs(x * np.sin(turn) + y * np.cos(turn)) < 0.15
    assert on_line.any() and (np.hypot(x, y)[on_line] > 9.0).all()


def test_a_large_building_across_the_pixels_can_be_read_with_its_labels():
    turn = np.deg2rad(17.0)
    row, column = np.indices((1200, 1200)) - 100
    x, y = column * np.cos(turn) + row * np.sin(turn), row * np.cos(turn) - column * np.sin(turn)
    comb = (x > 200) & (x < 1000) & (y > 0) & (y < 780) & ((y < 60) | (x % 24 > 3))
    image = np.where(comb & (np.abs(row - 500) < 595) & (np.abs(column - 500) < 595), 255, 0).astype(np.uint8)
    plan = from_raster(image, 0.1, valid=(image > 0).astype(np.int64))
    assert len(plan.rooms) == 1 and len(plan.walls) < 300


def test_a_shaft_is_no_floor_beside_a_hall_that_reaches_the_edge_of_the_image():
    image = np.full((400, 600), 254, np.uint8)
    image[100:180, 100:180] = 0
    image[110:170, 110:170] = 254
    assert from_raster(image, PIXEL).rooms[0].area > 500.0


def test_willow_garage_can_be_driven(data_dir):
    plan = load_floor_plan(data_dir / "willow_garage" / "willow-full.pgm", 0.1)
    image = cv2.imread(str(data_dir / "willow_garage" / "willow-full.pgm"), cv2.IMREAD_GRAYSCALE)
    cells = reachable(plan, free_cells(plan, 0.2, 0.1))
    pixels = np.floor(np.stack([587 - cells[:, 1] / 0.1, cells[:, 0] / 0.1], axis=1)).astype(int)
    near = np.zeros(image.shape, dtype=np.uint8)
    near[pixels[:, 0], pixels[:, 1]] = 1
    seen_free = (image > 240).astype(np.uint8)
    assert np.mean(seen_free[pixels[:, 0], pixels[:, 1]]) > 0.98  # nowhere through walls or the unknown
    driven = cv2.dilate(near, np.ones((9, 9), np.uint8))
    floor = cv2.morphologyEx(seen_free, cv2.MORPH_OPEN, np.ones((7, 7), np.uint8))
    assert np.mean(driven[floor > 0]) > 0.95


@pytest.mark.parametrize(
    ("image", "resolution", "valid", "message"),
    [
        (blank(), 0.0, None, "resolution"),
        (blank(), float("nan"), None, "resolution"),
        (blank(), 50.0, None, "resolution"),
        (blank().astype(float), PIXEL, None, "occupancy: holds float64"),
        (blank()[0], PIXEL, None, "occupancy: has shape"),
        (np.zeros((50, 50), np.uint8), PIXEL, None, "lightest pixel is 0"),
        (np.pad(np.full((1, 1), 254, np.uint8), 14), 1.0, None, "no free space"),
        (np.full((50, 50), 205, np.uint8), PIXEL, None, "occupancy: no free space"),
        (blank(), PIXEL, np.ones((3, 3), int), "valid"),
        (blank(), PIXEL, blank() / 2.0, "valid"),
        (blank(), PIXEL, np.zeros((100, 140), int), "no free space"),
        (np.full((1000, 1000), 254, np.uint8), 0.002, None, "resolution: is too fine"),
        (np.full((148, 232), 254, np.uint8), 0.001, None, "resolution: is too fine"),
        (np.full((4097, 4097), 254, np.uint8), 0.05, None, "occupancy: has more than 16 million pixels"),
        (np.full((200, 200), 254, np.uint8), 1.0, 1 + np.arange(40_000).reshape(200, 200), "more than 2000 labels"),
    ],
)
def test_bad_images_are_refused_by_name(image, resolution, valid, message):
    with pytest.raises(FloorPlanError, match=message):
        from_raster(image, resolution, valid=valid)
