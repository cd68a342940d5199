"""One command runs all benchmarks; their options are the keyword arguments of their functions."""

import importlib
import inspect
from pathlib import Path
from typing import Literal

import pytest

from slam_gym.bench.runner import BENCHMARKS, UsageError, data_folder, main, parser_for


def example(
    report,
    *,
    sizes: tuple[int, ...] = (1, 2),
    name: str = "office",
    ratio: float = 0.5,
    budget: int | None = None,
    data: Path | None = None,
    only: Literal["a", "b"] | None = None,
    quick: bool = False,
) -> None:
    """Do nothing.

    Arguments:
        sizes: of maps
        name: of a scenario
        ratio: of this to that
        budget: in ticks
        data: where it is
        only: one of two
        quick: or not
    """


def options(*argv):
    return vars(parser_for(example, "example", "About.").parse_args(argv))


def test_options_have_the_types_and_defaults_of_the_arguments():
    given = inspect.signature(example).parameters
    assert options() == {name: p.default for name, p in given.items() if name != "report"} | {"out": None}
    argv = "--sizes 3 4 5 --name hall --ratio 2 --budget 7 --data d --only b --quick --out o"
    assert options(*argv.split()) == {
        "sizes": [3, 4, 5], "name": "hall", "ratio": 2.0, "budget": 7, "data": Path("d"), "only": "b", "quick": True,
        "out": Path("o"),
    }  # fmt: skip


@pytest.mark.parametrize("wrong", ["--sizes x", "--only c", "--budget 1.5", "--none", "--quick 1"])
def test_what_does_not_fit_is_refused(wrong):
    with pytest.raises(SystemExit):
        options(*wrong.split())


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_benchmark_explains_itself_and_all_its_options(name, capsys):
    with pytest.raises(SystemExit, match="0"):
        main([*name.split(), "--help"])
    shown = capsys.readouterr().out
    module = importlib.import_module(f"slam_gym.bench.{BENCHMARKS[name].module}")
    assert module.__doc__.splitlines()[0] in shown and f"bench {name}" in shown and "--out" in shown
    for option in list(inspect.signature(module.run).parameters)[1:]:
        assert f"--{option}" in shown


def test_without_a_name_the_benchmarks_are_listed(capsys):
    assert main([]) == 2 and main(["nothing"]) == 2 and main(["--help"]) == 0
    listed = capsys.readouterr().err
    assert all(name in listed for name in BENCHMARKS)


def test_a_run_says_where_its_figures_come_from_and_misuse_how_it_is_used(capsys):
    argv = ["update", "--features", "10", "12", "--repeats", "1"]
    assert main(argv) == 0
    first, *_, last = capsys.readouterr().out.splitlines()
    assert (
        first.startswith(f"python -m slam_gym.bench {' '.join(argv)}") and "numpy" in first and last.split()[0] == "12"
    )
    with pytest.raises(SystemExit):
        main(["update", "--features", "3"])
    assert "at least 10 features" in capsys.readouterr().err
    assert issubclass(UsageError, ValueError)


def test_data_are_where_they_are_said_to_be_or_where_the_environment_says(monkeypatch):
    monkeypatch.setenv("SLAM_GYM_DATA", "there")
    assert data_folder(Path("here")) == Path("here") and data_folder(None) == Path("there")
    monkeypatch.delenv("SLAM_GYM_DATA")
    assert data_folder(None) is None
