"""Plans and images from strangers: each becomes a plan, or is refused by an error that names it."""

import gzip
import io
import json

import numpy as np
import pytest
from hypothesis import strategies as st

from slam_gym.world.floor_plan_file import load_floor_plan, save_floor_plan
from tests.fuzz.attack import attack
from tests.fuzz.inputs import WORDS, arrays, as_json, damaged, documents
from tests.world.test_floor_plan import square
from tests.world.test_floor_plan_file import blank

ROS = "image: image.npy\nresolution: 0.05\norigin: [-3.0, 2.0, 0.0]\nnegate: 0\nfree_thresh: 0.196\n"
ODD = (
    "[1, 2, 3]", "2001-01-01", "2001-99-99", "1:30", "{a: 1}", "!!binary aaaa", "!!set {a}", "!!timestamp 3", "&a [*a]",
    "*a", "<<", "~", "!!python/name:os.system", "[&a 1, *a, *a]", "image.pgm", "/dev/zero", "..", "." * 300, "[" * 3000,
    "- 1", "'", '"', "|", "? x",
)  # fmt: skip


@pytest.fixture
def cv2():
    return pytest.importorskip("cv2", reason="needs the extra `maps`")


def npy(array) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def test_plans_in_json(tmp_path, inputs, count) -> None:
    path = tmp_path / "plan.json"
    save_floor_plan(square(), path)
    whole = path.read_bytes()
    count(attack(load_floor_plan, path, damaged(whole), inputs // 2))
    count(attack(load_floor_plan, path, documents(json.loads(whole)).map(as_json), inputs - inputs // 2))


@pytest.mark.parametrize("suffix", ["png", "pgm"])
def test_images(suffix, tmp_path, inputs, count, cv2) -> None:
    image = blank()
    image[40:60, 50:60] = 0
    pictures = (image, np.dstack([image] * 3)) if suffix == "png" else (image,)
    wholes = [cv2.imencode(f".{suffix}", picture)[1].tobytes() for picture in pictures]
    path = tmp_path / f"map.{suffix}"
    count(attack(lambda file: load_floor_plan(file, 0.05), path, damaged(*wholes), inputs))


@pytest.mark.parametrize("suffix", ["npy", "npy.gz"])
def test_arrays(suffix, tmp_path, inputs, count, cv2) -> None:
    def packed(content: bytes) -> bytes:
        return gzip.compress(content, 1, mtime=0) if suffix == "npy.gz" else content

    def read(file):
        return load_floor_plan(file, 0.1)

    occupancy = npy(blank())
    (tmp_path / f"map_valid_space.{suffix}").write_bytes(packed(npy((blank() > 0).astype(np.uint8))))
    path = tmp_path / f"map_occ_map.{suffix}"
    count(attack(read, path, damaged(packed(occupancy)), inputs // 3))
    count(attack(read, path, damaged(occupancy).map(packed), inputs // 3))
    count(attack(read, path, arrays(blank()).map(lambda array: packed(npy(array))), inputs // 3))


def test_labels(tmp_path, inputs, count, cv2) -> None:
    """What is wrong with labels is told of the image that they belong to."""
    image, path = npy(blank()), tmp_path / "map_valid_space.npy"
    (tmp_path / "map_occ_map.npy").write_bytes(image)

    def read(_):
        try:
            return load_floor_plan(tmp_path / "map_occ_map.npy", 0.1)
        except ValueError as error:
            assert str(error).startswith(str(tmp_path / "map_occ_map.npy: "))
            raise ValueError(f"{path}: {error}") from None

    labels = np.where(blank() > 0, 1 + (np.arange(140) > 70), 0)
    wide = st.sampled_from((np.uint8, np.int64, np.uint64)).map(lambda kind: npy(labels.astype(kind)))
    count(attack(read, path, wide, 3))
    count(attack(read, path, damaged(npy(labels), npy(labels.astype(np.uint8))), inputs // 2))
    count(attack(read, path, arrays(labels).map(npy), inputs // 2))


def test_ros_maps(tmp_path, inputs, count, cv2) -> None:
    (tmp_path / "image.npy").write_bytes(npy(blank()))
    path = tmp_path / "map.yaml"
    count(attack(load_floor_plan, path, damaged(ROS.encode()), inputs // 2))
    value = st.sampled_from((*WORDS, *ODD))
    lines = st.lists(st.tuples(st.sampled_from([line.split(":")[0] for line in ROS.splitlines()]), value), max_size=3)
    text = lines.map(lambda changes: "".join(f"{key}: {value}\n" for key, value in _changed(changes)))
    count(attack(load_floor_plan, path, text.map(lambda t: t.encode("utf-8", "replace")), inputs - inputs // 2))


def _changed(changes):
    given = dict(line.split(": ", 1) for line in ROS.splitlines()) | dict(changes)
    return given.items()


def test_real_floors(tmp_path, data_dir, inputs, count, cv2) -> None:
    """Damaged bytes of real files: the smallest floor of KTH, and Willow Garage."""
    floor = (data_dir / "kth_floorplans" / "50052752_occ_map.npy.gz").read_bytes()
    read = damaged(floor), damaged(gzip.decompress(floor)).map(lambda content: gzip.compress(content, 1))
    for contents in read:
        count(attack(lambda file: load_floor_plan(file, 0.1), tmp_path / "map.npy.gz", contents, inputs // 15))
    garage = next((data_dir / "willow_garage").glob("*.pgm")).read_bytes()
    count(attack(lambda file: load_floor_plan(file, 0.1), tmp_path / "map.pgm", damaged(garage), inputs // 15))
