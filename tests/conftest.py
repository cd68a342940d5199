"""Fixtures shared by all tests."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of real recordings and floor plans: `SLAM_GYM_DATA`, or `../shared/data` beside the checkout."""
    given = os.environ.get("SLAM_GYM_DATA")
    folder = Path(given) if given else Path(__file__).parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no recordings: set SLAM_GYM_DATA to their folder (looked in {folder})")
    return folder
