"""Names of the benchmarks, and how one of them is run.

A benchmark is a module with a function `run(report, …)`. Its keyword arguments are the options of the command, told by
their type and default; their help stands under `Arguments` in its docstring, the module's docstring is the command's.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import os
import platform
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from slam_gym.bench.report import Report
from slam_gym.recordings.catalogue import DATA


class Benchmark(NamedTuple):
    """What stands behind a name."""

    module: str  # in slam_gym.bench
    about: str


BENCHMARKS = {
    "corridor": Benchmark("consistency.corridor", "reference experiment: associators in the corridor, 40 seeds"),
    "step": Benchmark("speed.step", "Explore-v0 steps per second against map size; where the time of a step goes"),
    "vector": Benchmark("speed.vector", "many worlds at once beside one; what a reset costs the others"),
    "jcbb": Benchmark("speed.jcbb", "JCBB at loop closure beside scipy's linear assignment on the same gated problem"),
    "prior": Benchmark("speed.prior", "all searches with a prior at loop closure: what they get right, time"),
    "update": Benchmark("speed.update", "joint EKF update against one symmetric rank-20 product"),
    "scale": Benchmark("speed.scale", "a step and its memory against map size, to 5 000 features"),
    "locality": Benchmark("locality.effort", "relocation under each locality against the bound of the source"),
    "locality --tracking": Benchmark("locality.tracking", "what locality saves JCBB in exploration"),
    "associate": Benchmark("feature_index.associate", "relocation by the feature index: time, success beside cliques"),
    "relocate": Benchmark("speed.relocate", "kidnapped robots of Relocate-v0 found again: searches and policies"),
    "recordings": Benchmark("recordings.relocations", "relocation on Victoria Park and MR.CLAM: right, wrong, none"),
    "consistency": Benchmark("consistency.comparison", "EKF, right-invariant, local maps on long loops"),
    "innovations": Benchmark("consistency.innovations", "NEES, NIS and whiteness at every level of drift"),
    "soak": Benchmark("soak.soak", "a million ticks with extreme settings: does anything break, does memory grow"),
    "sight": Benchmark("speed.sight", "line of sight on small and large floors; cost of physics and sensors"),
}


class UsageError(ValueError):
    """Options that do not go together, or lack something: the command says so and how it is used."""


class FailedError(Exception):
    """A benchmark that is a test has failed: the command says so and ends in 1."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark named first with the remaining arguments; 2 and the list of names where there is none such."""
    if not argv or argv[0] not in BENCHMARKS:
        lines = "\n".join(f"  {name:20s}{benchmark.about}" for name, benchmark in BENCHMARKS.items())
        asked = bool(argv) and argv[0] in ("-h", "--help")
        usage = f"usage: {_program()} NAME [options]   (NAME --help lists them)\n{lines}"
        print(usage, file=sys.stdout if asked else sys.stderr)
        return 0 if asked else 2
    variants = (option for option in argv[1:] if f"{argv[0]} {option}" in BENCHMARKS)
    name = " ".join([argv[0], *variants][:2])
    module = importlib.import_module(f"slam_gym.bench.{BENCHMARKS[name].module}")
    parser = parser_for(module.run, name, module.__doc__ or "")
    options = vars(parser.parse_args([option for option in argv[1:] if option not in name.split()]))
    report = Report(options.pop("out"))
    report.say(provenance(argv))
    try:
        with one_thread(report):
            module.run(report, **options)
    except UsageError as error:
        parser.error(str(error))
    except FailedError as error:
        report.say(f"failed: {error}")
        return 1
    return 0


def _program() -> str:
    """How the runner was called."""
    return "slam-gym bench" if Path(sys.argv[0]).stem == "slam-gym" else "python -m slam_gym.bench"


def one_thread(report: Report) -> AbstractContextManager[object]:
    """Keeps BLAS to one thread: on two, small products take 10 to 100 times as long."""
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        report.say("BLAS may use several threads: threadpoolctl is not installed (pip install 'slam_gym[bench]')")
        return nullcontext()
    limited: AbstractContextManager[object] = threadpool_limits(1)
    return limited


def parser_for(run: Callable[..., None], name: str, about: str) -> argparse.ArgumentParser:
    """Of the keyword arguments of `run`, and --out."""
    style = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(f"{_program()} {name}", description=about, formatter_class=style)
    helps = dict(re.findall(r"^\s+(\w+): (.+)$", run.__doc__ or "", re.MULTILINE))
    hints = get_type_hints(run)
    for option, parameter in list(inspect.signature(run).parameters.items())[1:]:
        taken = _taken(hints[option], parameter.default)
        parser.add_argument(f"--{option}", default=parameter.default, help=helps[option], **taken)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for CSV files and pictures")
    return parser


def _taken(hint: Any, default: Any) -> dict[str, Any]:
    """What argparse must know of an option: a flag, several values, one of some words, or one value."""
    if hint is bool:
        return {"action": "store_true"}
    if isinstance(default, tuple):
        return {"nargs": "+", "type": type(default[0])}
    kind = hint if default is not None else get_args(hint)[0]  # of `kind | None`
    return {"choices": get_args(kind)} if get_origin(kind) is Literal else {"type": kind}


def data_folder(given: Path | None) -> Path | None:
    """Where the recordings are: as given, or as the environment has it; None where nothing says so."""
    return given or (Path(os.environ[DATA]) if os.environ.get(DATA) else None)


def provenance(argv: Sequence[str]) -> str:
    """The command, the versions and the machine that figures come from, in one line."""
    versions = ", ".join(f"{name} {_version(name)}" for name in ("slam_gym", "numpy", "scipy", "numba"))
    return f"{_program()} {' '.join(argv)}   ({versions}, Python {platform.python_version()}, {platform.machine()})"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # run from a checkout
        return "of a checkout"
