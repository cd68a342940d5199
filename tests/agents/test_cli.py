"""What the commands share: options that become arguments, folders of results, errors in one line."""

import subprocess
import sys
from pathlib import Path
from typing import Annotated

import pytest
import typer

from agents.cli import command
from agents.evaluation.episodes import AssociateArguments, ExploreArguments
from agents.evaluation.records import results_folder
from agents.options import DRIFTING, AssociateWorld, Episodes, Execution, ExploreWorld
from slam_gym.__main__ import COMMANDS
from tests.agents import typed


def parsed(*words, group=ExploreWorld):
    """The group of options that a command is given."""
    found = []

    def main(options: group, names: Annotated[list[str] | None, typer.Option()] = None, quick: bool = False) -> None:
        found.append((options, names, quick))

    result = typed(command("try", main, ""), *words)
    assert result.exit_code == 0, result.output
    return found[0]


def test_without_options_the_arguments_are_the_defaults():
    assert parsed()[0].arguments("office", "test") == ExploreArguments()
    found = parsed(group=AssociateWorld)[0].worlds("train")
    assert found == [AssociateArguments(scenario=name) for name in DRIFTING]
    assert parsed(group=Episodes)[0].range(7) == range(7)
    assert parsed("--seed", 3, "--episodes", 2, group=Episodes)[0].range(7) == range(3, 5)
    with pytest.raises(ValueError, match="world 10001 of split 'test'"):
        parsed("--seed", 9_995, group=Episodes)[0].range(7)
    assert parsed("--seed", 9_995, group=Episodes)[0].range(7, "train") == range(9_995, 10_002)


def test_options_change_the_arguments():
    line = ["--scenario", "hall", "--set", "sensor.range=4", "--set", "dynamics.people=3", "--relocation", "none"]
    found = parsed(*line, "--floor-plan", "a.json")[0].arguments("office", "train")
    assert found.overrides == (("sensor.range", 4), ("dynamics.people", 3)) and found.relocation is None
    assert found.floor_plan == str(Path("a.json").resolve()) and found.scenario == "hall" and found.split == "train"
    assert parsed("--floor-plan", "a.json")[0].arguments("office", "test").scenario == "building"
    own = parsed("--scenario", "hall", "--candidates", 3, "--set", "budget=5", group=AssociateWorld)[0].worlds("test")
    assert own == [AssociateArguments("hall", candidates=3, split="test", overrides=(("budget", 5),))]


def test_several_scenarios_are_several_loops_and_one_too_many_where_one_is_asked_for():
    found = parsed("--scenario", "hall", "crowd", "--scenario", "hall")[0]
    assert [loop.scenario for loop in found.loops(["office"], "test")] == ["hall", "crowd"]
    with pytest.raises(ValueError, match="hall and crowd"):
        found.arguments("office", "train")


@pytest.mark.parametrize(
    ("raised", "code", "said"),
    [
        (ValueError("what is it?"), 2, "error: what is it?\n"),
        (OSError(28, "No space left on device", "report.html"), 2, "error: [Errno 28] No space left on device"),
        (KeyboardInterrupt(), 130, "interrupted\n"),
        (ZeroDivisionError(), 1, ""),  # a fault of the package keeps its traceback
    ],
)
def test_what_ends_a_command_is_told_in_one_line(raised, code, said):
    def main(execution: Execution) -> None:
        raise raised

    result = typed(command("try", main, ""))
    assert result.exit_code == code and result.stderr.startswith(said) and result.stderr.count("\n") <= 1


def test_resume_without_folder_means_the_latest_of_this_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("office-20250101-000000", "office-20250301-000000", "office-small-20250401-000000"):
        (tmp_path / "results" / name).mkdir(parents=True)
    assert results_folder("office", resume=True) == Path("results/office-20250301-000000")
    assert results_folder("floor", resume=False).name.startswith("floor-2")
    with pytest.raises(ValueError, match="hall"):
        results_folder("hall", resume=True)


def test_options_are_known_before_anything_that_takes_time_is_imported():
    modules = ", ".join(f"agents.{name.replace('-', '_')}" for name in COMMANDS)
    slow = {"torch", "matplotlib", "pygame", "numba", "scipy", "pandas"}
    code = f"import sys, {modules}; print({slow} & set(sys.modules))"
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True)
    assert done.stdout == "set()\n", done.stderr
