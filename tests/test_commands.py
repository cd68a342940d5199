"""`slam-gym`: every command by one name, bad input in one line, from wherever it is called."""

import importlib
import json
import subprocess
import sys
from functools import partial
from importlib.metadata import PackageNotFoundError

import numpy as np
import pytest
import typer
from joblib.externals.loky.process_executor import TerminatedWorkerError

import slam_gym
from agents.cli import ended
from slam_gym import __main__ as commands
from tests.agents import typed


def test_every_command_is_a_module_with_an_app_and_is_told_about():
    shown = typed(commands.app, "--help").output
    for name in commands.COMMANDS:
        assert callable(importlib.import_module(f"agents.{name.replace('-', '_')}").app) and f" {name} " in shown


def test_the_version_is_that_of_the_package():
    assert typed(commands.app, "--version").output == f"slam_gym {slam_gym.__version__}\n"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["evaluat"], "No such command 'evaluat'. Did you mean 'evaluate'?"),
        (["evaluate", "--scenario", "offic"], "error: unknown scenario 'offic'; did you mean 'office'?"),
        (["evaluate", "--no-such-option"], "No such option: --no-such-option"),
        (["doctor", "now"], "unexpected extra argument"),
    ],
)
def test_bad_input_is_named(line, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = typed(commands.app, *line)
    assert result.exit_code == 2 and said in result.stderr


def test_a_missing_package_is_named_with_what_installs_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pandas", None)  # as if they were not installed
    monkeypatch.setitem(sys.modules, "torch", None)
    for name in [name for name in sys.modules if name.startswith("agents.") and "drivers" not in name]:
        monkeypatch.delitem(sys.modules, name)
    result = typed(commands.app, "report", "results")
    assert (result.exit_code, result.stderr) == (2, "error: pandas is missing: pip install 'slam_gym[agents]'\n")
    for module, advice in (("torch", ": pip install 'slam_gym[learn]'"), ("what_a_user_imports", "")):
        with pytest.raises(typer.Exit):
            ended(partial(importlib.import_module, module))
        assert capsys.readouterr().err == f"error: {module} is missing{advice}\n"


def test_a_worker_that_was_killed_is_told_in_one_line(capsys):
    def command():
        raise TerminatedWorkerError("exit codes of the workers are {SIGKILL(-9)}")

    with pytest.raises(typer.Exit) as end:
        ended(command)
    assert end.value.exit_code == 2 and capsys.readouterr().err.startswith("error: a worker process was killed")


def test_a_module_of_ones_own_is_found_where_the_command_is_given(tmp_path):
    """By the script that pip puts on the path, which leaves the current folder out of Python's."""
    (tmp_path / "mine.py").write_text("class Still:\n    name, action = 'still', 'twist'\n")
    script = "import sys; sys.path.pop(0); from slam_gym.__main__ import app; app()"
    line = "evaluate --agents mine:Still yours:Still"
    done = subprocess.run([sys.executable, "-c", script, *line.split()], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: agent 'yours:Still': No module named 'yours'; known: random, ")


def test_it_runs_in_a_folder_with_another_package_of_that_name(tmp_path):
    (tmp_path / "agents").mkdir()
    (tmp_path / "agents" / "__init__.py").touch()
    line = (
        "evaluate --agents random --scenario office-small --set budget=20 --episodes 1 --no-films --jobs 1 --output out"
    )
    command = [sys.executable, "-m", "slam_gym", *line.split()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    assert results["complete"] and results["commands"][0]["command"].startswith("slam-gym evaluate --agents random")


# --- what the doctor says is so ---------------------------------------------------------------------------------------


def test_versions_are_those_installed_and_what_is_missing_is_told_with_its_extra(monkeypatch):
    known = commands.version

    def without_torch(name):
        if name == "torch":
            raise PackageNotFoundError(name)
        return known(name)

    monkeypatch.setattr(commands, "version", without_torch)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "nowhere")  # counting what is cached takes seconds where there is much
    lines = list(commands.report())
    packages = {words[0]: " ".join(words[1:]) for line in lines if line.startswith("  ") and (words := line.split())}
    assert packages["numpy"] == np.__version__
    assert "torch" not in packages and "slam_gym" not in packages
    told = next(line for line in lines if line.startswith("  pip install 'slam_gym[learn]'"))
    assert "torch" in told and "numpy" not in told


def test_it_tells_where_recordings_are_looked_for(monkeypatch, tmp_path):
    (tmp_path / "mrclam").mkdir()
    monkeypatch.setenv("NUMBA_CACHE_DIR", "nowhere")
    monkeypatch.setenv("SLAM_GYM_DATA", str(tmp_path))
    assert f"recordings: SLAM_GYM_DATA={tmp_path} (mrclam)" in list(commands.report())
    monkeypatch.delenv("SLAM_GYM_DATA")
    assert any("SLAM_GYM_DATA is not set" in line for line in commands.report())


def test_it_tells_how_much_is_compiled(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert any("empty: the first step ever compiles" in line for line in commands.report())
    (tmp_path / "slam_gym" / "abc").mkdir(parents=True)
    (tmp_path / "slam_gym" / "abc" / "f.nbc").write_bytes(bytes(2_000_000))
    assert any(f"{tmp_path / 'slam_gym'} (1 compiled functions, 2 MB)" in line for line in commands.report())
