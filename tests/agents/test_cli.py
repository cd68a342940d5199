"""What the commands share: options that become arguments, folders of results, errors in one line."""

import argparse
import subprocess
import sys
from pathlib import Path

import pytest

from agents.cli import (
    add_associate_options,
    add_explore_options,
    associate_arguments,
    command_line,
    explore_arguments,
    require_positive,
    results_folder,
    run_main,
)
from agents.evaluation.episodes import AssociateArguments, ExploreArguments


def parsed(add, *line):
    parser = argparse.ArgumentParser()
    add(parser)
    return parser.parse_args(line)


def test_without_options_the_arguments_are_the_defaults():
    explore = parsed(lambda p: add_explore_options(p, "office"))
    assert explore_arguments(explore, split="test") == ExploreArguments()
    assert associate_arguments(parsed(add_associate_options), "train") == AssociateArguments()


def test_options_change_the_arguments():
    line = ["--scenario", "hall", "--set", "sensor.range=4", "--set", "dynamics.people=3", "--relocation", "gcbb"]
    found = explore_arguments(parsed(lambda p: add_explore_options(p, "office"), *line, "--floor-plan", "a.json"))
    assert found.overrides == (("sensor.range", 4), ("dynamics.people", 3)) and found.relocation == "gcbb"
    assert found.floor_plan == str(Path("a.json").resolve()) and found.scenario == "hall"
    on_a_floor = parsed(lambda p: add_explore_options(p, "office"), "--floor-plan", "a.json")
    assert explore_arguments(on_a_floor).scenario == "building"
    own = associate_arguments(parsed(add_associate_options, "--candidates", "3", "--set", "budget=5"), "test")
    assert own == AssociateArguments(candidates=3, split="test", overrides=(("budget", 5),))


def test_an_override_without_value_is_refused(capsys):
    with pytest.raises(SystemExit):
        parsed(add_associate_options, "--set", "sensor.range")
    assert "NAME=VALUE" in capsys.readouterr().err


def test_numbers_must_be_positive_where_they_are_given():
    require_positive(argparse.Namespace(episodes=1, eval_every=None), "episodes", "eval_every")
    with pytest.raises(ValueError, match="--eval-every must be at least 1, not 0"):
        require_positive(argparse.Namespace(eval_every=0), "eval_every")


def test_resume_without_folder_means_the_latest_of_this_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("office-20250101-000000", "office-20250301-000000", "office-small-20250401-000000"):
        (tmp_path / "results" / name).mkdir(parents=True)
    assert results_folder("office", resume=True) == Path("results/office-20250301-000000")
    assert results_folder("floor", resume=False).name.startswith("floor-2")
    with pytest.raises(ValueError, match="hall"):
        results_folder("hall", resume=True)


def test_errors_are_told_in_one_line(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["command", "word"])

    def refuse(argv):
        raise ValueError(f"what is {argv[0]}?")

    def interrupted(argv):
        raise KeyboardInterrupt

    assert run_main(lambda argv: 7) == 7
    assert run_main(refuse) == 2 and capsys.readouterr().err == "error: what is word?\n"
    assert run_main(interrupted) == 130
    assert command_line("agents.train", ["--out", "a b"]) == "python -m agents.train --out 'a b'"


def test_help_needs_no_learning_library():
    code = "import sys; import agents.evaluate, agents.evaluate_association, agents.play; "
    code += "sys.exit(bool({'torch', 'matplotlib', 'pygame'} & set(sys.modules)))"
    root = Path(__file__).parents[2]
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0
