"""What the doctor says is so."""

from importlib.metadata import PackageNotFoundError

import numpy as np

from slam_gym import doctor


def test_versions_are_those_installed_and_what_is_missing_is_told_with_its_extra(monkeypatch):
    known = doctor.version

    def without_torch(name):
        if name == "torch":
            raise PackageNotFoundError(name)
        return known(name)

    monkeypatch.setattr(doctor, "version", without_torch)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "nowhere")  # counting what is cached takes seconds where there is much
    lines = list(doctor.report())
    packages = {words[0]: " ".join(words[1:]) for line in lines if line.startswith("  ") and (words := line.split())}
    assert packages["numpy"] == np.__version__
    assert "torch" not in packages and "slam_gym" not in packages
    told = next(line for line in lines if line.startswith("  pip install 'slam_gym[learn]'"))
    assert "torch" in told and "numpy" not in told


def test_it_tells_where_recordings_are_looked_for(monkeypatch, tmp_path):
    (tmp_path / "mrclam").mkdir()
    monkeypatch.setenv("NUMBA_CACHE_DIR", "nowhere")
    monkeypatch.setenv("SLAM_GYM_DATA", str(tmp_path))
    assert f"recordings: SLAM_GYM_DATA={tmp_path} (mrclam)" in list(doctor.report())
    monkeypatch.delenv("SLAM_GYM_DATA")
    assert any("SLAM_GYM_DATA is not set" in line for line in doctor.report())


def test_it_tells_how_much_is_compiled(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert any("empty: the first step ever compiles" in line for line in doctor.report())
    (tmp_path / "slam_gym" / "abc").mkdir(parents=True)
    (tmp_path / "slam_gym" / "abc" / "f.nbc").write_bytes(bytes(2_000_000))
    assert any(f"{tmp_path / 'slam_gym'} (1 compiled functions, 2 MB)" in line for line in doctor.report())
