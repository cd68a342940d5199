"""`slam-gym report`: makes the report of an evaluation again from its folder."""

from pathlib import Path
from typing import Annotated

from typer import Argument

from agents.cli import command


def main(folder: Annotated[Path, Argument(metavar="DIR", help="The folder of an evaluation.")]) -> None:
    """Make the report of an evaluation again."""
    from agents.reports.pages import write_report

    write_report(folder)
    print(folder / "report.html")


app = command("report", main, "results/office-20260101-120000")

if __name__ == "__main__":
    app()
