"""The report of an evaluation of any kind: `python -m agents.report DIR` makes it again from the files in its folder.

One HTML file with its pictures inside; only films lie beside it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from agents.cli import program, run_main
from agents.evaluation.pipeline import Results, read_results
from agents.evaluation.records import write_whole
from agents.reports import associators, drivers, recordings, suite
from agents.reports.page import Report, page

REPORTS: dict[str, Callable[[Results, Path], Report]] = {
    "drivers": drivers.report,
    "associators": associators.report,
    "suite": suite.report,
    "recordings": recordings.report,
}
"""By the kind of evaluation."""


def write_report(folder: Path) -> Path:
    """Write report.html into the folder of an evaluation, from the files there, and return its path.

    Raises ValueError where it holds none, or nothing finished yet.
    """
    results = read_results(folder)
    if results.kind.name not in REPORTS:
        raise ValueError(f"{folder} belongs to the {results.kind.name}, which makes its own page")
    path = folder / "report.html"
    write_whole(path, page(REPORTS[results.kind.name](results, folder), results.content))
    return path


def main(argv: list[str]) -> int:
    p = argparse.ArgumentParser(prog=program("agents.report"), description="Make the report of an evaluation again.")
    p.add_argument("folder", type=Path, metavar="DIR", help="that an evaluation wrote into")
    print(write_report(p.parse_args(argv).folder))
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
