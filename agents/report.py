"""The report of a finished evaluation, made again from its folder: `python -m agents.report results/office-…`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument

from agents.cli import command
from agents.reports.page import write_report


def main(folder: Annotated[Path, Argument(metavar="DIR", help="That an evaluation wrote into.")]) -> None:
    """Make the report of an evaluation again."""
    print(write_report(folder))


app = command(main)
if __name__ == "__main__":
    app()
