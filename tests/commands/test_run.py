"""`slam-gym`: every command by one name, bad input in one line, from wherever it is called."""

import importlib
import json
import subprocess
import sys

import pytest
from joblib.externals.loky.process_executor import TerminatedWorkerError

import slam_gym
from slam_gym.commands import run


def test_every_command_has_a_main_and_is_told_about(capsys):
    assert run.main([]) == run.main(["--help"]) == 0
    shown = capsys.readouterr().out
    for name, command in run.COMMANDS.items():
        assert callable(importlib.import_module(command.module).main) and f"  {name} " in shown


def test_the_version_is_that_of_the_package(capsys):
    assert run.main(["--version"]) == 0
    assert capsys.readouterr().out == f"slam_gym {slam_gym.__version__}\n"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (["evaluat"], "unknown command 'evaluat'; did you mean 'evaluate'? known: evaluate, "),
        (["evaluate", "--scenario", "offic"], "unknown scenario 'offic'"),
        (["doctor", "now"], "doctor takes no arguments, got now"),
    ],
)
def test_bad_input_ends_in_one_line(line, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run.main(line) == 2
    told = capsys.readouterr().err.strip()
    assert told.startswith("error: ") and said in told and "\n" not in told


def test_a_missing_package_is_named_with_what_installs_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rich.console", None)  # as if it were not installed
    monkeypatch.delitem(sys.modules, "agents.play", raising=False)
    monkeypatch.delitem(sys.modules, "agents.cli", raising=False)
    assert run.main(["play"]) == 2
    assert capsys.readouterr().err.strip() == "error: rich is missing: pip install 'slam_gym[agents]'"


@pytest.mark.parametrize(
    ("raised", "code", "said"),
    [
        (OSError(28, "No space left on device", "report.html"), 2, "No space left on device: 'report.html'"),
        (TerminatedWorkerError("exit codes of the workers are {SIGKILL(-9)}"), 2, "a worker process was killed"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_what_breaks_a_command_is_told_in_one_line(raised, code, said, capsys):
    def command():
        raise raised

    assert run.ended(command) == code
    told = capsys.readouterr().err.strip()
    assert said in told and "\n" not in told


def test_a_fault_of_the_package_keeps_its_traceback():
    def command():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run.ended(command)


def test_a_module_of_ones_own_is_found_where_the_command_is_given(tmp_path):
    """By the script that pip puts on the path, which leaves the current folder out of Python's."""
    (tmp_path / "mine.py").write_text("class Still:\n    name, action = 'still', 'twist'\n")
    script = "import sys; sys.path.pop(0); from slam_gym.commands.run import main; sys.exit(main(sys.argv[1:]))"
    line = "evaluate --agents mine:Still yours:Still"
    done = subprocess.run([sys.executable, "-c", script, *line.split()], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: agent 'yours:Still': No module named 'yours'; known: random, ")


def test_it_runs_in_a_folder_without_agents(tmp_path):
    line = "evaluate --agents random --scenario office-small --set budget=20 --episodes 1 --no-films --jobs 1 --out out"
    command = [sys.executable, "-m", "slam_gym", *line.split()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    assert results["complete"] and results["commands"][0]["command"].startswith("slam-gym evaluate --agents random")
