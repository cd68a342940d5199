"""What the pages say is so: their Python runs, their commands parse, the files and names they mention are there."""

import importlib
import importlib.util
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import nbformat
import pytest
import typer
from typer.main import get_command

from slam_gym.__main__ import COMMANDS
from slam_gym.scenarios import SCENARIOS
from slam_gym.world.floor_plan_file import load_floor_plan

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "slam_gym/**/FORMAT.md", "notebooks/*.ipynb")
    for path in ROOT.glob(pattern)
)
IN_THE_REPOSITORY = [path for path in PAGES if path.suffix == ".md" and ROOT / "docs" not in path.parents]
NEEDS_DATA = "# with SLAM_GYM_DATA"  # first line of blocks that read public logs
NEEDS_PACKAGE = re.compile(r"# with ([a-z]\w+)\n")  # likewise of blocks that need what no extra installs
ENVIRONMENT = re.compile(r"\w+=")
UsageError = typer.BadParameter.__base__  # of typer, which does not export it
INLINE_COMMAND = re.compile(r"(time )?(python -[mc]|pip|pytest|mkdocs|slam-gym(?! (COMMAND|policy|NAME))) ")


class Block(NamedTuple):
    """A fenced block of a page."""

    language: str
    code: str
    line: int  # of its first line, counted from 1


def text_of(page: Path) -> str:
    """The text of a page; of a notebook, that of its Markdown cells."""
    if page.suffix == ".md":
        return page.read_text(encoding="utf-8")
    return "\n\n".join(cell.source for cell in nbformat.read(page, as_version=4).cells if cell.cell_type == "markdown")


def blocks(text: str) -> Iterator[Block]:
    for found in re.finditer(r"^```(\w*)[^\n]*\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        yield Block(found[1], found[2], text[: found.start()].count("\n") + 2)


def outside_blocks(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def inline_code(text: str) -> list[str]:
    return re.findall(r"`([^`\n]+)`", outside_blocks(text))


def of(page: Path) -> str:
    return str(page.relative_to(ROOT))


# -- commands --------------------------------------------------------------------------------------------------------


def commands(script: str) -> Iterator[list[str]]:
    """The simple commands of a shell script, as words: comments, loops, `time` and variables taken away."""
    values = dict(re.findall(r"for (\w+) in (\S+)", script))
    for line in script.replace("\\\n", " ").splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
        lexer.wordchars += "[],:$…"
        command: list[str] = []
        for word in [*lexer, ";"]:
            if word in (";", "&&", "||", "|"):
                if command and command[0] != "for":
                    yield command
                command = []
            elif not (not command and (word in ("do", "done", "time", "export") or ENVIRONMENT.match(word))):
                command.append(re.sub(r"\$(\w+)", lambda name: values.get(name[1], name[0]), word))


def check_command(command: list[str], complete: bool = True) -> None:
    """Hold a command's arguments against its own parser. AssertionError or SystemExit where they do not fit.

    A command that is merely mentioned, not `complete`, may leave out all of its arguments.
    """
    match command:
        case ["python", "-m", "venv" | "rl_zoo3.train", *_] | [".", _]:
            pass
        case ["python", "-m", name, *_] if name.startswith("tests."):
            importlib.import_module(name)
        case ["python", "-m", name, *arguments]:
            module = importlib.import_module(name)
            if arguments or complete:
                get_command(module.app).make_context(name, list(arguments))
        case ["python", "-c", code]:
            compile(code, "the command", "exec")
        case ["python", file, *arguments]:
            assert (ROOT / file).is_file(), file
            check_script((ROOT / file).read_text(encoding="utf-8"), arguments)
        case ["pip", "install", *arguments]:
            known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
            for extra in re.findall(r"(?:\.|slam_gym)\[([\w,]+)\]", " ".join(arguments)):
                assert set(extra.split(",")) <= set(known), f"no extra {extra}"
        case ["pytest", *arguments]:
            assert all((ROOT / path).exists() for path in arguments if path.startswith("tests")), arguments
        case ["jupyter", "nbconvert", *arguments]:
            assert all((ROOT / path).is_file() for path in arguments if path.endswith(".ipynb")), arguments
        case ["slam-gym", "doctor" | "--help" | "--install-completion"] | ["slam-gym", "list", *_]:
            pass
        case ["slam-gym", name, *arguments]:
            assert name in COMMANDS, name
            if arguments or complete:
                module = importlib.import_module(f"agents.{name.replace('-', '_')}")
                found: Any = get_command(module.app)
                if several := getattr(found, "commands", {}):
                    found, arguments = several[arguments[0]], arguments[1:]
                found.make_context(name, list(arguments))
        case ["evo_ape" | "evo_rpe" | "evo_traj", "tum", first, *rest]:
            assert all(path.endswith(".tum") for path in (first, *rest) if "/" in path), rest
        case ["mkdocs", "build" | "serve", *_] | ["ruff", "check" | "format", *_] | ["mypy"] | ["git", *_]:
            pass
        case _:
            raise AssertionError(f"a command that this test does not know: {command}")


def check_script(source: str, arguments: list[str]) -> None:
    """Options of a benchmark are `--quick`, `--seed`, and what its source names."""
    for option in (word[2:] for word in arguments if word.startswith("--")):
        assert option in ("quick", "seed") or re.search(rf"\b{option}=|--{option}\b", source), option


# -- the pages -------------------------------------------------------------------------------------------------------


@pytest.fixture
def scenarios_as_before() -> Iterator[None]:
    """Pages show how to register a scenario; other tests shall not see it."""
    before = dict(SCENARIOS)
    yield
    SCENARIOS.clear()
    SCENARIOS.update(before)


def with_python(page: Path) -> bool:
    return page.suffix == ".md" and any(block.language == "python" for block in blocks(text_of(page)))


def needed(block: Block) -> str:
    """The package that a block of Python says it needs; empty for none."""
    found = NEEDS_PACKAGE.match(block.code) if block.language == "python" else None
    return found[1] if found else ""


ELSEWHERE = [
    (page, block) for page in PAGES if page.suffix == ".md" for block in blocks(text_of(page)) if needed(block)
]


@pytest.mark.parametrize(("page", "block"), ELSEWHERE, ids=[needed(block) for _, block in ELSEWHERE])
def test_python_of_other_packages_runs_where_they_are(page: Path, block: Block, tmp_path: Path) -> None:
    """In a process of its own, since such packages leave threads and servers behind."""
    package = needed(block)
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed: {of(page)} says how")
    where = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    script = tmp_path / "block.py"
    script.write_text(block.code, encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], cwd=tmp_path, env=where, capture_output=True, text=True)
    assert done.returncode == 0, f"{of(page)}, line {block.line}: {done.stderr[-3000:]}"


@pytest.mark.usefixtures("scenarios_as_before")
@pytest.mark.parametrize("page", [page for page in PAGES if with_python(page)], ids=of)
def test_python_runs(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names: dict[str, object] = {"__name__": "__main__"}
    code = [block for block in blocks(text_of(page)) if block.language == "python" and not needed(block)]
    logs = [block for block in code if block.code.startswith(NEEDS_DATA)]
    for block in code:
        if block in logs:
            monkeypatch.setenv("SLAM_GYM_DATA", str(request.getfixturevalue("data_dir")))  # skips without the data
        program = "\n" * (block.line - 1) + block.code  # so that a traceback has the line of the page
        exec(compile(program, of(page), "exec"), names)


@pytest.mark.parametrize("page", PAGES, ids=of)
def test_commands_parse(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = text_of(page)
    scripts = [(block.code, True) for block in blocks(text) if block.language in ("bash", "sh")]
    scripts += [(code, False) for code in inline_code(text) if re.match(INLINE_COMMAND, code)]
    for script, complete in scripts:
        for command in commands(script):
            try:
                check_command(command, complete)
            except (AssertionError, ImportError, KeyError, SystemExit, UsageError) as error:
                pytest.fail(f"{of(page)}: {shlex.join(command)}: {error} {capsys.readouterr().err}")


@pytest.mark.parametrize("name", COMMANDS)
def test_the_example_of_a_command_parses(name: str) -> None:
    command = get_command(importlib.import_module(f"agents.{name.replace('-', '_')}").app)
    for one in getattr(command, "commands", {name: command}).values():
        check_command(shlex.split(one.epilog.removeprefix("Example: ")))
        assert one.epilog.startswith(f"Example: slam-gym {name} ")


@pytest.mark.parametrize("page", PAGES, ids=of)
def test_files_and_names_exist(page: Path) -> None:
    for code in inline_code(text_of(page)):
        if re.fullmatch(r"(slam_gym|agents|tests|docs|notebooks)/[\w./-]*(?<!-v\d)", code):
            assert (ROOT / code).exists(), f"{of(page)}: no file {code}"
        elif re.fullmatch(r"slam_gym(\.\w+)+", code):
            assert resolves(code), f"{of(page)}: no {code}"


def resolves(dotted: str) -> bool:
    """Whether a dotted name is that of a module or of something in one."""
    parts = dotted.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for name in parts[cut:]:
            if not hasattr(found, name):
                return False
            found = getattr(found, name)
        return True
    return False


@pytest.mark.parametrize("page", IN_THE_REPOSITORY, ids=of)
def test_links_of_the_repository_lead_somewhere(page: Path) -> None:
    """Those between pages of the site are checked by `mkdocs build --strict`."""
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", outside_blocks(text_of(page))):
        assert "://" in target or (page.parent / target).exists(), f"{of(page)}: no {target}"


def test_the_format_page_of_floor_plans_shows_one(tmp_path: Path) -> None:
    (example,) = (b for b in blocks(text_of(ROOT / "slam_gym/world/FORMAT.md")) if b.language == "json")
    (tmp_path / "plan.json").write_text(example.code)
    assert load_floor_plan(tmp_path / "plan.json").name == "two rooms"


def test_readme_is_short_and_results_are_six_short_pages_with_their_plots() -> None:
    assert len(text_of(ROOT / "README.md").splitlines()) <= 100
    pages = sorted((ROOT / "docs" / "results").glob("*.md"))
    assert len(pages) <= 6
    assert sum(len(text_of(page).split()) for page in pages) <= 4000
    for page in pages:
        for background in ("light", "dark"):
            plot = page.with_name(f"{page.stem}-{background}.svg")
            assert plot.is_file() and plot.name in text_of(page), "python docs/results/plots.py draws it"


def test_pictures_are_small_and_shown_and_none_is_missing() -> None:
    pages = "\n".join(map(text_of, PAGES)) + (ROOT / "docs" / "hooks.py").read_text()
    folder = ROOT / "docs" / "pictures"
    for picture in folder.glob("*.png"):
        assert picture.stat().st_size < 150_000, picture.name
        assert picture.name in pages or picture.name.startswith(("scenario_", "small_")) or picture.stem in pages
    names = [spec.name.lower() for spec in gym.registry.values() if spec.namespace == "slam_gym"]
    for name in [*names, *(f"{size}_{scenario}" for scenario in SCENARIOS for size in ("scenario", "small"))]:
        assert (folder / f"{name}.png").is_file(), f"python docs/pictures.py draws {name}.png"
    assert (folder / "film.gif").stat().st_size < 2_000_000 and "film.gif" in text_of(ROOT / "README.md")


# -- these checks can fail -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    ["python benchmarks/corridor.py --no-such-option", "slam-gym evaluate --episodes many", "rm -r results",
     "pip install -e .[nothing]", "pytest tests/no_such_test.py", "python benchmarks/nothing.py"],
)  # fmt: skip
def test_wrong_commands_are_refused(command: str) -> None:
    with pytest.raises((AssertionError, KeyError, SystemExit, UsageError)):
        check_command(shlex.split(command))
