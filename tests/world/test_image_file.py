"""Images are as large as their headers say, and no larger than may be."""

import numpy as np
import pytest

from slam_gym.world.floor_plan import FloorPlanError
from slam_gym.world.image_file import read_image


@pytest.fixture
def cv2():
    return pytest.importorskip("cv2", reason="needs the extra `maps`")


def test_pictures_and_arrays_come_back(tmp_path, cv2) -> None:
    image = np.arange(120, dtype=np.uint8).reshape(10, 12)
    np.save(tmp_path / "a.npy", image.T)
    np.testing.assert_array_equal(read_image(tmp_path / "a.npy"), image.T)
    for suffix in ("png", "pgm"):
        cv2.imwrite(str(tmp_path / f"a.{suffix}"), image)
        np.testing.assert_array_equal(read_image(tmp_path / f"a.{suffix}"), image)
    (tmp_path / "text.pgm").write_bytes(b"P2 # a comment\n# another\n3 1\n255\n1 2 3\n")
    assert read_image(tmp_path / "text.pgm").tolist() == [[1, 2, 3]]


def test_other_formats_under_a_name_that_is_known_are_refused(tmp_path, cv2) -> None:
    for suffix in ("bmp", "jpg", "tiff"):
        (tmp_path / "a.png").write_bytes(cv2.imencode(f".{suffix}", np.zeros((9, 9), np.uint8))[1].tobytes())
        with pytest.raises(FloorPlanError, match="is not a PGM or PNG image"):
            read_image(tmp_path / "a.png")


def test_arrays_of_too_many_pixels_are_refused(tmp_path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((1 << 13, (1 << 11) + 1), bool))
    with pytest.raises(FloorPlanError, match="has 8192 × 2049 pixels"):
        read_image(tmp_path / "a.npy")
