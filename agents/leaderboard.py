"""`slam-gym leaderboard --entry jcbb` evaluates an entry by the frozen protocol, and ranks it.

An entry is an agent, an associator or a relocator: a name, `module:Class`, `module:function` or a model file. It runs
in a process of its own, and receives observations only. The command writes into --board: the folder ROLE-NAME with the
results of its evaluation, and leaderboard.md, which ranks all entries there and the shipped ones. Without --entry, it
only makes the page again. The same command resumes an interrupted entry.
"""

import sys
from collections.abc import Collection
from pathlib import Path
from typing import Annotated

from typer import Option

from agents.cli import command
from agents.options import Execution, Role

MARKS = "<!-- the tables: slam-gym leaderboard --page FILE -->", "<!-- end of the tables -->"
"""The marks between which a page gets its tables."""


def main(
    execution: Execution,
    entry: Annotated[
        str | None, Option(metavar="NAME", help="Name, module:Class, module:function, model file.")
    ] = None,
    role: Annotated[Role | None, Option(help="By default derived from NAME.")] = None,
    board: Annotated[Path, Option(metavar="DIR", help="Where entries and the page go.")] = Path("leaderboard"),
    quick: Annotated[bool, Option("--quick", help="A few worlds, to try an entry.")] = False,
    page: Annotated[Path | None, Option(metavar="FILE", help="Put the tables between the marks of this page.")] = None,
) -> None:
    """Evaluate and rank an entry by the frozen protocol, or rank all entries again."""
    from agents.evaluation.records import write_whole
    from agents.ranking.board import BASELINES, folders_in, markdown, read_entries

    if not entry and (role or quick or execution != Execution()):
        raise ValueError("--entry is missing: the other options are about its evaluation")
    if page:
        with_tables(page.read_text(encoding="utf-8"), "")  # raises for a page without marks, before the evaluation
    evaluated = {_evaluate(entry, role or _role_of(entry), quick, board, execution)} if entry else set()
    shipped, _ = read_entries(folders_in(BASELINES))
    own, refused = read_entries(folders_in(board) | evaluated)
    for line in refused:
        print(f"left out: {line}", file=sys.stderr)
    tried = {entry.protocol["role"] for entry in own if entry.protocol["quick"]}
    tables = markdown([*shipped, *(entry.quick() for entry in shipped if entry.protocol["role"] in tried), *own])
    board.mkdir(parents=True, exist_ok=True)
    write_whole(board / "leaderboard.md", f"# Leaderboard\n\n{tables}\n")
    if page:
        write_whole(page, with_tables(page.read_text(encoding="utf-8"), tables))
    print(f"leaderboard: {board / 'leaderboard.md'}")


def _evaluate(entry: str, role: Role, quick: bool, board: Path, execution: Execution) -> Path:
    """Evaluate the entry by the protocol, or by the rest of it; returns the folder of its results."""
    from agents.evaluation.pipeline import METADATA, carry_out, unfinished
    from agents.evaluation.records import stem
    from agents.ranking.protocol import Protocol, leaderboard_evaluation, process
    from slam_gym.simulation.judged import CEILING

    if entry != CEILING or role != "associator":  # no process runs it, since it uses the truth
        process(role, entry)  # raises for an invalid entry, before anything is written
    name = f"{role}-{stem(entry)}{'-quick' if quick else ''}"
    out = execution.output or board / name
    resume = execution.resume or unfinished(out)
    if not resume and (out / METADATA).exists():
        raise ValueError(f"{out} has finished: --resume keeps it as it is; delete the folder to evaluate it again")
    frame = carry_out(leaderboard_evaluation(entry, Protocol(role, quick)), out, execution.jobs, resume).frame
    failed = frame["failed"].dropna() if "failed" in frame else ()
    if len(failed):
        print(f"{len(failed)} of {len(frame)} episodes are lost: {failed.iloc[0]}")
    print(f"entry: {out}")
    return out


def _role_of(entry: str) -> Role:
    """The role of an entry, from the tables of names and the suffix of a model file. A `module:Class` is an agent."""
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
    """The page with the tables between its marks. Raises ValueError where it has no marks."""
    before, begin, rest = page.partition(MARKS[0])
    _, end, after = rest.partition(MARKS[1])
    if not (begin and end):
        raise ValueError(f"the page lacks {MARKS[0]!r} and {MARKS[1]!r}")
    return f"{before}{begin}\n\n{tables}\n\n{end}{after}"


app = command("leaderboard", main, "--entry jcbb --quick")

if __name__ == "__main__":
    app()
