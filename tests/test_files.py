"""Files are read up to a size, and refused with a reason."""

import gzip
import io
import zipfile

import numpy as np
import pytest

from slam_gym._files import array_of, content_of, gunzipped, json_of, zip_members


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


@pytest.mark.parametrize("array", [np.arange(6.0).reshape(2, 3), np.arange(6).reshape(2, 3).T, np.array("text")])
def test_arrays_come_back(array) -> None:
    np.testing.assert_array_equal(array_of(npy(array), "fiuU"), array)


def test_gzip_gives_all_members_up_to_a_limit() -> None:
    two = gzip.compress(b"abc") + gzip.compress(b"def")
    assert gunzipped(two) == b"abcdef" and gunzipped(two, 6) == b"abcdef" and gunzipped(b"") == b""
    with pytest.raises(ValueError, match="unpacks to more than 1 MB"):
        gunzipped(gzip.compress(bytes(1 << 21)), 1 << 20)
    for damaged in (two[:-9], b"no gzip", two[:-6] + b"123456"):
        with pytest.raises(ValueError, match="no readable gzip file"):
            gunzipped(damaged)


def archive(*members: tuple[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as out:
        for name, content in members:
            out.writestr(name, content)
    return file.getvalue()


def test_content_is_read_up_to_a_limit(tmp_path) -> None:
    (tmp_path / "file").write_bytes(bytes(11))
    assert len(content_of(tmp_path / "file", 11)) == 11
    with pytest.raises(ValueError, match="is larger than"):
        content_of(tmp_path / "file", 10)


def test_what_is_no_array_of_numbers_is_refused() -> None:
    whole = npy(np.zeros((10, 10)))
    for content, kinds, message in (
        (whole[:-8], "f", "is not a numpy array"),
        (whole, "iu", "entries of type float64"),
        (npy(np.array([None], object)), "fiuU", "is not a numpy array"),
        (b"", "f", "is not a numpy array"),
    ):
        with pytest.raises(ValueError, match=message):
            array_of(content, kinds)
    with pytest.raises(ValueError, match="is larger than 0 MB"):
        array_of(whole, "f", limit=799)


def test_zip_members_are_read_up_to_a_limit() -> None:
    assert zip_members(archive(("a", b"1"), ("b", b"2"))) == {"a": b"1", "b": b"2"}
    with pytest.raises(ValueError, match="unpacks to more than 1 MB"):
        zip_members(archive(("a", bytes(1 << 21))), 1 << 20)
    for damaged in (b"", b"PK\x05\x06", archive(("a", b"1"))[:-3]):
        with pytest.raises(ValueError, match="zip file"):
            zip_members(damaged)


def test_json_is_finite() -> None:
    assert json_of(b'{"a": [1, {"b": null}]}') == {"a": [1, {"b": None}]}
    for text, message in (("[NaN]", "NaN"), ("9" * 5000, "digits"), ("[" * 100_000, "nested too deeply")):
        with pytest.raises(ValueError, match=message):
            json_of(text)
