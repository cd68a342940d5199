"""Floor plans in files: JSON gives back the same plan, every format of an image the same floor; faults are named."""

import copy
import gzip
import json
import pickle
from dataclasses import asdict

import numpy as np
import pytest

from slam_gym.world.floor_plan import FloorPlanError
from slam_gym.world.floor_plan_file import load_floor_plan, save_floor_plan
from slam_gym.world.generators import OfficeGenerator
from tests.rollouts import differences
from tests.world.test_floor_plan import square

PIXEL = 0.05  # [m]


def blank(height=100, width=140):
    """A room of free pixels within a wall 10 pixels thick."""
    image = np.zeros((height, width), dtype=np.uint8)
    image[10:-10, 10:-10] = 254
    return image


@pytest.fixture
def cv2():
    return pytest.importorskip("cv2", reason="needs the extra `maps`")


@pytest.mark.parametrize(
    "plan", [square(), square(rooms=(), doors=(), furniture=()), OfficeGenerator()(np.random.default_rng(3))]
)
def test_json_and_pickle_give_back_the_same_plan(plan, tmp_path):
    save_floor_plan(plan, tmp_path / "plan.json")
    for again in (load_floor_plan(tmp_path / "plan.json"), pickle.loads(pickle.dumps(plan))):
        assert not differences(asdict(again), asdict(plan))  # not in a bit


def edited(document, path, value):
    """A copy with the value at `path` replaced, or removed where it is `...`."""
    document = copy.deepcopy(document)
    place = document
    for key in path[:-1]:
        place = place[key]
    if value is ...:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return document


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("surprise",), 1, "file: the key 'surprise' is missing or unknown"),
        (("features", 1, "colour"), "red", r"features\[1\]: the key 'colour'"),
        (("walls",), ..., "file: .*walls"),
        (("doors", 0, "width"), ..., r"doors\[0\]: .*width"),
        (("version",), 2, "format, version"),
        (("name",), 7, "name: is not a text"),
        (("name",), float("nan"), "NaN"),
        (("walls",), 5, "walls: is not|walls: has shape"),
        (("walls", 0), [0, 0, 1], "walls: is not a table"),
        (("walls", 0, 0), float("nan"), "NaN"),
        (("features",), {}, "features: is not a list"),
        (("features", 2, "kind"), ["corner"], r"features\[2\].kind"),
        (("features", 2, "size"), -1, r"features.sizes\[2\]"),
        (("rooms", 0), [], r"rooms\[0\]: is not an object"),
        (("rooms", 0, "polygon"), [], "polygon: encloses no area"),
        (("doors", 0, "rooms"), ["left"], "door: rooms"),
        (("doors", 0, "rooms"), 3, "doors?: "),
        (("doors", 0, "position"), [], "door: position"),
        (("furniture", 0, "position"), [1, 2, 3], "furniture: position: has shape"),
        (("furniture", 0, "heading"), "north", "furniture: sizes: is not a table"),
    ],
)
def test_bad_files_are_refused_by_file_field_and_reason(path, value, message, tmp_path):
    file = tmp_path / "plan.json"
    save_floor_plan(square(), file)
    file.write_text(json.dumps(edited(json.loads(file.read_text()), path, value)))
    with pytest.raises(FloorPlanError, match=message) as caught:
        load_floor_plan(file)
    assert str(caught.value).startswith(f"{file}: ")


def test_missing_files_and_unknown_suffixes(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        load_floor_plan(tmp_path / "nowhere.json")
    (tmp_path / "plan.docx").write_bytes(b"")
    with pytest.raises(FloorPlanError, match="unknown suffix"):
        load_floor_plan(tmp_path / "plan.docx", 0.1)


@pytest.mark.parametrize("suffix", ["npy", "npy.gz", "png", "pgm", "yaml"])
def test_every_format_gives_the_same_plan(suffix, tmp_path, cv2):
    from slam_gym.world.raster import from_raster

    image, path = blank(), tmp_path / f"map.{suffix}"
    if suffix == "npy":
        np.save(path, image)
    elif suffix == "npy.gz":
        with gzip.open(path, "wb") as file:
            np.save(file, image)
    elif suffix == "yaml":
        cv2.imwrite(str(tmp_path / "image.pgm"), image)
        path.write_text(
            "image: image.pgm\nresolution: 0.05\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
        )
    else:
        cv2.imwrite(str(path), image)
    plan = load_floor_plan(path, None if suffix == "yaml" else PIXEL)
    np.testing.assert_array_equal(plan.walls, from_raster(image, PIXEL).walls)
    assert plan.name == "map"


@pytest.mark.parametrize("negate", [0, 1])
@pytest.mark.parametrize("threshold", [0.196, 0.25])
def test_what_a_ros_map_has_not_explored_is_no_floor_whatever_its_threshold(tmp_path, cv2, threshold, negate):
    image = blank()
    image[40:60, 40:60] = 205
    cv2.imwrite(str(tmp_path / "image.pgm"), 255 - image if negate else image)
    settings = f"free_thresh: {threshold}\nnegate: {negate}"
    (tmp_path / "map.yaml").write_text(f"image: image.pgm\nresolution: 0.05\n{settings}")
    assert len(load_floor_plan(tmp_path / "map.yaml").features.positions) == 8
    (tmp_path / "map.yaml").write_text(f"image: image.pgm\nresolution: 0.05\nmode: scale\n{settings}")
    assert len(load_floor_plan(tmp_path / "map.yaml").features) == (4 if threshold > 50 / 255 else 8)  # a probability


def test_pixels_that_are_transparent_are_refused_and_opaque_ones_are_read(tmp_path, cv2):
    image = cv2.cvtColor(blank(), cv2.COLOR_GRAY2BGRA)
    cv2.imwrite(str(tmp_path / "map.png"), image)
    assert len(load_floor_plan(tmp_path / "map.png", PIXEL).features) == 4
    image[image[..., 0] == 0] = (255, 255, 255, 0)
    cv2.imwrite(str(tmp_path / "map.png"), image)
    with pytest.raises(FloorPlanError, match="has transparent pixels"):
        load_floor_plan(tmp_path / "map.png", PIXEL)


def test_ros_map_origin_and_negate(tmp_path, cv2):
    cv2.imwrite(str(tmp_path / "image.png"), 255 - blank())
    (tmp_path / "map.yaml").write_text("image: image.png\nresolution: 0.05\norigin: [-3.0, 2.0, 0.0]\nnegate: 1\n")
    plan = load_floor_plan(tmp_path / "map.yaml")
    np.testing.assert_allclose(plan.bounds, [-2.5, 2.5, 3.5, 6.5], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("map.png", b"not a picture", "image: is not a PGM or PNG"),
        ("map.pgm", b"", "image"),
        ("map.npy", b"\x93NUMPY broken", "image: is not a numpy array"),
        ("map.yaml", b"[1, 2]", "image: the map names no image"),
        ("map.yaml", b"image: gone.pgm\nresolution: 0.1\n", "image: .*No such file|image: .*too long"),
        ("map.yaml", b"image: a\nresolution: fine\n", "resolution: 'fine' is not a number"),
        ("map.yaml", b"image: a\nresolution: 0.1\norigin: [0, 0, 1]\n", "origin"),
        ("map.yaml", b"image: a\nresolution: 0.1\nmode: raw\n", "mode: 'raw' is neither"),
        ("map.yaml", b"image: a\nresolution: 0.1\nfree_thresh: 5\n", "free_thresh: 5.0 is not between 0 and 1"),
        ("map.yaml", b"image: a\nresolution: 0.1\nnegate: 2\n", "negate: 2.0 is neither 0 nor 1"),
        ("map.yaml", b"image: {\n", "file: is not YAML"),
        ("map.yaml", b"image: " + b"[" * 2000, "file: is not YAML"),
        ("map.yaml", b"image: a\nresolution: 2001-99-99\n", "file: is not YAML"),
        ("map.yaml", b"image: a\nresolution: 2001-01-01\n", "resolution: .* is not a number"),
        ("map.yaml", b"image: a\nresolution: " + b"9" * 400, "resolution: .*too large"),
        ("map.yaml", b"image: a\nresolution: .nan\n", "resolution: nan is not a number"),
        ("map.yaml", b"image: " + b"a" * 400 + b"\nresolution: 0.1\n", "image: .*No such file|image: .*too long"),
        ("map.yaml", b"x" * 20_000, "file: is not YAML .*larger than"),
        ("map.npy.gz", gzip.compress(bytes(300 << 20), 1), "image: unpacks to more than 128 MB"),
    ],
)
def test_bad_image_files_are_refused_by_file_and_reason(name, content, message, tmp_path, cv2):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(FloorPlanError, match=message) as caught:
        load_floor_plan(path, 0.1 if name != "map.yaml" else None)
    assert str(path) in str(caught.value)


def test_pickled_arrays_are_not_unpickled(tmp_path):
    np.save(tmp_path / "map.npy", np.array([print], dtype=object), allow_pickle=True)
    with pytest.raises(FloorPlanError, match="is not a numpy array"):
        load_floor_plan(tmp_path / "map.npy", 0.1)
