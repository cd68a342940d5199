"""Put an entry through the frozen protocol, and rank it: `python -m agents.leaderboard --entry jcbb`.

An entry is an agent, an associator or a relocator, by name, `module:Class`, `module:function` or model file. It runs in
a process of its own, and sees observations only. Writes into --board: ROLE-NAME.json, and leaderboard.md, which ranks
all entries there and those that ship. Without --entry, the page is made again. An interrupted entry goes on when its
command is given again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from agents.cli import add_execution_options, command_line, execution, program, require_positive, run_main
from agents.evaluation.pipeline import carry_out
from agents.evaluation.records import write_whole
from agents.ranking.entries import BASELINES, ranked, read_entries, write_entry
from agents.ranking.protocol import protocol
from agents.ranking.served import entry, role_of
from agents.ranking.table import markdown
from agents.ranking.tasks import leaderboard_evaluation
from slam_gym.simulation.judged import CEILING

MARKS = "<!-- the tables: python -m agents.leaderboard --page FILE -->", "<!-- end of the tables -->"
"""Between these a page gets its tables."""


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog=program("agents.leaderboard"), description="Rank an entry by the frozen protocol, or rank all once more."
    )
    p.add_argument("--entry", metavar="NAME", help="name, module:Class, module:function or model file (.pt)")
    p.add_argument("--role", choices=("agent", "associator", "relocator"), help="default: as its name tells")
    p.add_argument("--board", type=Path, default=Path("leaderboard"), metavar="DIR", help="default: %(default)s")
    p.add_argument("--quick", action="store_true", help="a few worlds, to try an entry; ranked apart")
    p.add_argument("--page", type=Path, metavar="FILE", help="put the tables between the marks of this page as well")
    p.add_argument("--no-baselines", dest="baselines", action="store_false", help="leave out the entries that ship")
    add_execution_options(p, "BOARD/runs/ROLE-NAME")
    return p


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    require_positive(a, "jobs")
    if a.entry:
        _run(a, command_line("agents.leaderboard", argv))
    entries = read_entries([*([BASELINES] if a.baselines else []), a.board])
    if not entries:
        raise ValueError(f"there is no entry in {a.board}: give one with --entry")
    tables = markdown(entries)
    a.board.mkdir(parents=True, exist_ok=True)
    write_whole(a.board / "leaderboard.md", f"# Leaderboard\n\n{tables}\n")
    if a.page:
        write_whole(a.page, with_tables(a.page.read_text(encoding="utf-8"), tables))
    print(f"leaderboard: {a.board / 'leaderboard.md'}")
    return 0


def _run(a: argparse.Namespace, command: str) -> None:
    """Put the entry through the protocol, or through what is left of it, and write its file."""
    role = a.role or role_of(a.entry)
    if a.entry != CEILING:  # which no process is told of
        entry(role, a.entry)  # refuses what is none before anything is written
    chosen = protocol(role, a.quick)
    stem = f"{role}-{Path(a.entry).name.replace(':', '.')}{'-quick' if a.quick else ''}"
    out = a.out or a.board / "runs" / stem
    how = execution(a, command)
    if (out / "results.json").exists():
        how = execution(argparse.Namespace(**(vars(a) | {"resume": True})), command)
    results = carry_out(leaderboard_evaluation(a.entry, chosen), out, how)
    seconds = sum(float(run.get("seconds", 0.0)) for run in results.content["commands"])
    path = write_entry(a.board, ranked(a.entry, chosen, results.records, command, seconds))
    how.console.print(f"entry: {path}", soft_wrap=True)


def with_tables(page: str, tables: str) -> str:
    """The page with the tables between its marks. Raises ValueError where it has none."""
    before, begin, rest = page.partition(MARKS[0])
    _, end, after = rest.partition(MARKS[1])
    if not (begin and end):
        raise ValueError(f"the page lacks {MARKS[0]!r} and {MARKS[1]!r}")
    return f"{before}{begin}\n\n{tables}\n\n{end}{after}"


if __name__ == "__main__":
    raise SystemExit(run_main(main))
