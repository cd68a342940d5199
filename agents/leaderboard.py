"""`slam-gym leaderboard --entry jcbb` puts an entry through the frozen protocol, and ranks it.

An entry is an agent, an associator or a relocator, by name, `module:Class`, `module:function` or model file. It runs in
a process of its own, and sees observations only. Writes into --board: ROLE-NAME.json, and leaderboard.md, which ranks
all entries there and those that ship. Without --entry, the page is made again. An interrupted entry goes on when its
command is given again.
"""

from __future__ import annotations

import sys
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Option

from agents.cli import command
from agents.options import Execution

if TYPE_CHECKING:
    from agents.ranking.protocol import Role

MARKS = "<!-- the tables: slam-gym leaderboard --page FILE -->", "<!-- end of the tables -->"
"""Between these a page gets its tables."""


def main(
    execution: Execution,
    entry: Annotated[
        str | None, Option(metavar="NAME", help="Name, module:Class, module:function, model file.")
    ] = None,
    role: Annotated[
        Literal["agent", "associator", "relocator"] | None, Option(help="By default as NAME tells.")
    ] = None,
    board: Annotated[Path, Option(metavar="DIR", help="Where entries and the page go.")] = Path("leaderboard"),
    quick: Annotated[bool, Option("--quick", help="A few worlds, to try an entry; ranked apart.")] = False,
    page: Annotated[Path | None, Option(metavar="FILE", help="Put the tables between the marks of this page.")] = None,
) -> None:
    """Rank an entry by the frozen protocol, or rank all once more."""
    from agents.evaluation.records import write_whole
    from agents.ranking.board import BASELINES, markdown, read_entries

    if entry:
        _evaluate(entry, role or _role_of(entry), quick, board, execution)
    entries, refused = read_entries([BASELINES, board])
    for line in refused:
        print(f"left out: {line}", file=sys.stderr)
    tables = markdown(entries)
    board.mkdir(parents=True, exist_ok=True)
    write_whole(board / "leaderboard.md", f"# Leaderboard\n\n{tables}\n")
    if page:
        write_whole(page, with_tables(page.read_text(encoding="utf-8"), tables))
    print(f"leaderboard: {board / 'leaderboard.md'}")


def _evaluate(entry: str, role: Role, quick: bool, board: Path, execution: Execution) -> None:
    """Put the entry through the protocol, or through what is left of it, and write its file."""
    from agents.evaluation.pipeline import METADATA, carry_out
    from agents.evaluation.records import command_line
    from agents.ranking.board import ranked, write_entry
    from agents.ranking.entry_process import EntryError
    from agents.ranking.protocol import Protocol, leaderboard_evaluation, process
    from slam_gym.simulation.judged import CEILING

    if entry != CEILING:  # which no process is told of
        try:
            process(role, entry)  # refuses what is none before anything is written
        except EntryError as error:
            raise ValueError(str(error)) from None
    chosen = Protocol(role, quick)
    stem = f"{role}-{Path(entry).name.replace(':', '.')}{'-quick' if quick else ''}"
    out = execution.output or board / "runs" / stem
    resumed = replace(execution, resume=execution.resume or (out / METADATA).exists())
    records = carry_out(leaderboard_evaluation(entry, chosen), out, resumed).frame.to_dict("records")
    failed = [record["failed"] for record in records if isinstance(record.get("failed"), str)]
    if failed:
        print(f"{len(failed)} of {len(records)} episodes are lost: {failed[0]}")
    print(f"entry: {write_entry(board, ranked(entry, chosen, records, command_line()))}")


def _role_of(entry: str) -> Role:
    """By the tables of names, and by what a training writes; a `module:Class` is an agent."""
    if Path(entry).suffix == ".npz":
        return "associator"
    from agents.drivers.base import AGENTS
    from slam_gym.association import ASSOCIATORS, RELOCATORS

    tables: dict[Role, Collection[str]] = {"agent": AGENTS, "associator": ASSOCIATORS, "relocator": RELOCATORS}
    roles = [role for role, table in tables.items() if entry in table]
    if len(roles) > 1:
        raise ValueError(f"entry {entry!r}: give --role, for it is the name of {' and '.join(roles)}")
    return roles[0] if roles else "agent"


def with_tables(page: str, tables: str) -> str:
    """The page with the tables between its marks. Raises ValueError where it has none."""
    before, begin, rest = page.partition(MARKS[0])
    _, end, after = rest.partition(MARKS[1])
    if not (begin and end):
        raise ValueError(f"the page lacks {MARKS[0]!r} and {MARKS[1]!r}")
    return f"{before}{begin}\n\n{tables}\n\n{end}{after}"


app = command(main, "slam-gym leaderboard --entry jcbb --quick")

if __name__ == "__main__":
    app()
