"""Generates pages of the site; MkDocs calls this module while it builds.

The pages of environments and scenarios are made from their registries and docstrings, the reference from the packages,
the tutorials from the notebooks; the pages of formats, changelog and contributing are copies of files elsewhere in the
repository.
"""

import ast
import dataclasses
import inspect
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import slam_gym
from slam_gym import scenarios
from slam_gym.scenarios import SCENARIOS, Scenario
from slam_gym.scenarios.suite import EXPERIMENTS

ROOT = Path(__file__).parents[1]
CACHE = ROOT / ".cache" / "notebooks"

COPIES = {
    "changelog.md": "CHANGELOG.md",
    "contributing.md": "CONTRIBUTING.md",
    "formats/recording.md": "slam_gym/recordings/FORMAT.md",
    "formats/floor_plan.md": "slam_gym/world/FORMAT.md",
}
"""Pages of the site that are copies of files of the repository: the page, and the file."""

ROOMS = {
    "slam_gym": "Geometry, checks of arguments, commands",
    "slam_gym.types": "The data that rooms exchange",
    "slam_gym.world": "The truth: floor plans, physics, sensors",
    "slam_gym.mapping": "The stochastic map",
    "slam_gym.navigation": "What the robot knows of the space around it",
    "slam_gym.association": "Compatibility and the interpretation tree",
    "slam_gym.association.tracking": "Searches with a prior on the pose",
    "slam_gym.association.relocation": "Searches without a prior on the pose",
    "slam_gym.slam": "One step of SLAM; losing and finding the robot; several maps",
    "slam_gym.metrics": "Comparison with the truth: associations, errors of map and path, consistency",
    "slam_gym.recordings": "Real logs",
    "slam_gym.scenarios": "Named configurations",
    "slam_gym.simulation": "Episodes: world and estimate side by side",
    "slam_gym.rendering": "Pictures",
    "slam_gym.envs": "The Gymnasium environments",
    "agents": "Commands: evaluate, train, play",
    "agents.drivers": "Drivers",
    "agents.learning": "Learned drivers and associators",
    "agents.evaluation": "Running evaluations",
    "agents.reports": "Tables, figures, films, pages",
    "agents.ranking": "The leaderboard: protocol, board, process of an entry",
}
"""Packages in the order of the reference, and what each is about. The page of a package documents its modules."""


# -- MkDocs ----------------------------------------------------------------------------------------------------------


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the generated pages to the navigation."""
    notebooks = [f"tutorials/{path.name}" for path in sorted((ROOT / "notebooks").glob("*.ipynb"))]
    environments = ["environments/index.md", *(f"environments/{_file(spec.id)}.md" for spec in _environments())]
    scenarios = ["scenarios/index.md", *(f"scenarios/{name}.md" for name in SCENARIOS), "scenarios/suite.md"]
    reference = ["reference/index.md", *(f"reference/{room}.md" for room in ROOMS)]
    generated = {"Tutorials": notebooks, "Environments": environments, "Scenarios": scenarios, "Reference": reference}
    for entry in config.nav or []:
        (section,) = entry
        entry[section] += generated.get(section, [])
        if section == "Bring your own":
            entry[section] += [page for page in COPIES if page.startswith("formats/")]
    return config


@event_priority(100)  # before mkdocs-jupyter, which must find the notebooks
def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add every generated page to the files of the site."""
    for uri, content in _pages():
        files.append(File.generated(config, uri, content=content))
    CACHE.mkdir(parents=True, exist_ok=True)
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        target = CACHE / "tutorials" / path.name
        target.parent.mkdir(exist_ok=True)
        target.write_text(_notebook(path), encoding="utf-8")
        files.append(File(f"tutorials/{path.name}", str(CACHE), config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Replace `<!-- benchmarks -->` by the table of the benchmarks."""
    scripts = [path for path in sorted((ROOT / "benchmarks").glob("*.py")) if path.stem != "common"]
    abouts = [
        (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").splitlines()[0] for path in scripts
    ]
    rows = [f"`python benchmarks/{path.name}` | {about}" for path, about in zip(scripts, abouts)]
    return markdown.replace("<!-- benchmarks -->", _table("Benchmark | What it measures", rows))


# -- parts of pages ---------------------------------------------------------------------------------------------------


def _page(*parts: str) -> str:
    """The paragraphs with a blank line between them, without empty ones."""
    return "\n\n".join(filter(None, parts)) + "\n"


def _table(titles: str, rows: Iterable[str]) -> str:
    """Markdown of a table; `titles` and each row are the text between the outer bars."""
    lines = [titles, "|".join(["---"] * len(titles.split("|"))), *rows]
    return "\n".join(f"| {line} |" if line[0] != "-" else f"|{line}|" for line in lines)


def _pages() -> Iterator[tuple[str, str]]:
    for uri, path in COPIES.items():
        yield uri, _on_the_site((ROOT / path).read_text(encoding="utf-8"), uri)
    for spec in _environments():
        yield f"environments/{_file(spec.id)}.md", _environment(spec)
    yield "scenarios/index.md", _scenario_index()
    for scenario in SCENARIOS.values():
        yield f"scenarios/{scenario.name}.md", _scenario(scenario)
    yield "scenarios/suite.md", _suite()
    yield "reference/index.md", _reference_index()
    for room, about in ROOMS.items():
        yield f"reference/{room}.md", _reference(room, about)


def _on_the_site(text: str, uri: str) -> str:
    """The text with links between files of the repository replaced by links between pages of the site."""
    up = "../" * uri.count("/")
    text = re.sub(r"\]\(docs/", f"]({up}", text)
    text = re.sub(r"\]\((?:\.\./)*notebooks/", f"]({up}tutorials/", text)
    for page, path in COPIES.items():
        text = re.sub(rf"\]\((?:\.\./)*{re.escape(path)}", f"]({up}{page}", text)
    return text


def _notebook(path: Path) -> str:
    """The notebook with its links replaced by those of the site, where every page is a folder."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    for cell in notebook["cells"]:
        if cell["cell_type"] == "markdown":
            text = "".join(cell["source"])
            text = re.sub(r"\]\((\w+)\.ipynb\)", r"](../\1/)", text)
            for page, file in COPIES.items():
                text = text.replace(f"](../{file})", f"](../../{page.removesuffix('.md')}/)")
            text = re.sub(r"\]\(\.\./docs/([\w/]+)\.md(#[\w-]+)?\)", r"](../../\1/\2)", text)
            shown = r"![\1](../../\2-light.svg#only-light)![\1](../../\2-dark.svg#only-dark)"
            text = re.sub(r"!\[([^]]*)\]\(\.\./docs/(\S+)-light\.svg\)", shown, text)
            text = text.replace("](../docs/", "](../../")  # pictures
            cell["source"] = text.splitlines(keepends=True)
    return json.dumps(notebook, ensure_ascii=False, indent=1)


# -- environments ----------------------------------------------------------------------------------------------------


def _environments() -> list[Any]:
    return [spec for spec in gym.registry.values() if spec.namespace == "slam_gym"]


def _file(environment: str) -> str:
    return environment.partition("/")[2].partition("-")[0].lower()


def _class_of(spec: Any) -> Any:
    return gym.envs.registration.load_env_creator(spec.entry_point)


def _environment(spec: Any) -> str:
    """The page of an environment: picture, docstring, arguments with their defaults, and spaces."""
    class_ = _class_of(spec)
    made = gym.make(spec.id).unwrapped
    rows = [f"`{field.name}` | `{field.default!r}`" for field in dataclasses.fields(class_.settings)]
    spaces = [f"`{name}` | `{space}`" for name, space in made.observation_space.items()]
    return _page(
        f"# {spec.id}",
        f"![A picture of {spec.id}](../pictures/{_file(spec.id)}.png){{ .picture }}",
        inspect.getdoc(class_) or "",
        "## Arguments and their defaults",
        _table("Argument | Default", rows),
        "## Spaces, with the defaults",
        f"Action space: `{made.action_space}`",
        _table("Observation | Space", spaces),
        f"Reference: [`{class_.__name__}`](../reference/slam_gym.envs.md)",
    )


# -- scenarios -------------------------------------------------------------------------------------------------------


def _scenario_index() -> str:
    rows = [
        f"[![A world of {s.name}](../pictures/small_{s.name}.png)]({s.name}.md) | [`{s.name}`]({s.name}.md) | "
        f"{_about(s)} | {_worlds(s)} | {s.budget}"
        for s in SCENARIOS.values()
    ]
    suite = " | [`closure/0` …](suite.md) | one parameter in five levels | The 40 levels of the suite | 600"
    return _page(
        "# Scenarios",
        "A scenario defines everything about an episode but its seed: a generator of worlds, a robot with its "
        "sensors, noise and filter, and a budget. [Your own scenario](../own/scenario.md) says how to change one.",
        _table(" | Scenario | What is special | Worlds | Ticks (0.1 s)", [*rows, suite]),
    )


def _worlds(scenario: Scenario) -> str:
    return (inspect.getdoc(type(scenario.generator)) or "").partition("\n")[0]


def _about(scenario: Scenario) -> str:
    """The comment above its entry in the registry; empty if there is none."""
    found = re.search(rf'# (.+)\n\s*\w+\(\s*"{scenario.name}",', inspect.getsource(scenarios))
    return found[1] if found else ""


def _differences(scenario: Scenario) -> list[tuple[str, Any, Any]]:
    """The settings in which a scenario differs from the defaults: dotted name, value and default."""
    default = Scenario(scenario.name, scenario.generator, scenario.budget)
    return list(_compared("", scenario, default))


def _compared(path: str, value: Any, default: Any) -> Iterator[tuple[str, Any, Any]]:
    if is_dataclass(value) and type(value) is type(default):
        for field in fields(value):
            below = f"{path}.{field.name}" if path else field.name
            yield from _compared(below, getattr(value, field.name), getattr(default, field.name))
    elif value != default:
        yield path, value, default


def _scenario(scenario: Scenario) -> str:
    generator = scenario.generator
    parameters = [f"`generator.{field.name}` | `{getattr(generator, field.name)!r}`" for field in fields(generator)]
    rows = [f"`{path}` | `{value!r}` | `{default!r}`" for path, value, default in _differences(scenario)]
    return _page(
        f"# {scenario.name}",
        f"![A world of {scenario.name}](../pictures/scenario_{scenario.name}.png){{ .picture }}",
        f"**{_about(scenario)}**" if _about(scenario) else "",
        f"*Test world 1, driven by `information_gain` for all of its {scenario.budget} ticks of 0.1 s.*",
        f"`{type(generator).__name__}`: {inspect.getdoc(type(generator))}",
        "## Settings that differ from the defaults",
        _table("Setting | Here | Default", rows) if rows else "All settings have their default values.",
        "## Settings of the generator",
        _table("Setting | Here", parameters),
        "[Your own scenario](../own/scenario.md) says how to change any setting by name.",
    )


def _suite() -> str:
    parts = []
    for experiment in EXPERIMENTS.values():
        ids = " | ".join(f"`{level.id}`" for level in experiment.levels)
        knobs = " | ".join(f"{level.knob:g}" for level in experiment.levels)
        parts += [f"## {experiment.name}", f"**{experiment.question}** {experiment.why}"]
        parts.append(_table(f" | {ids}", [f"{experiment.axis} | {knobs}"]))
    return _page(
        "# Levels of the suite",
        f"The suite has {len(EXPERIMENTS)} experiments, each of which varies one parameter in five levels, from easy "
        "to hard. The id of a level, such as `closure/3`, is accepted wherever the name of a scenario is. "
        "[Which associator?](../results/associators.md) has the scores.",
        *parts,
    )


# -- reference -------------------------------------------------------------------------------------------------------


def _modules(room: str) -> list[str]:
    """The public modules of a room, including those of its packages that are no rooms of their own."""
    folder = ROOT / room.replace(".", "/")
    below = folder.glob("*.py") if room in ("slam_gym", "agents") else folder.rglob("*.py")
    names = []
    for path in sorted(below):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        inner = name != room and any(
            name == other or name.startswith(f"{other}.")
            for other in ROOMS
            if other != room and other.startswith(f"{room}.")
        )
        listed = _has_docstring(path) if name == room else not (inner or path.stem.startswith("_"))
        if listed:
            names.append(name)
    return names


def _has_docstring(path: Path) -> bool:
    return bool(ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))))


def _reference_index() -> str:
    rows = [f"[`{room}`]({room}.md) | {about}" for room, about in ROOMS.items()]
    names = _table("`from slam_gym import …` | ", map(_public_name, slam_gym.__all__))
    return _page("# Reference", _table("Package | ", rows), "## What users import", names)


def _public_name(name: str) -> str:
    """A row of the table of public names, with a link to the definition."""
    thing = getattr(slam_gym, name)
    if callable(thing):
        return f"[`{name}`][{thing.__module__}.{name}] | {(inspect.getdoc(thing) or '').partition(chr(10))[0]}"
    module = slam_gym._home(name).__name__
    about = _constants(module).get(name)
    return f"[`{name}`][{module}.{name}] | {about}" if about else f"`{name}` | = {thing}"


def _constants(module: str) -> dict[str, str]:
    """The first line of the docstring of each constant of a module, by name."""
    path = ROOT / module.replace(".", "/")
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    body = ast.parse(path.read_text(encoding="utf-8")).body
    found = {}
    for node, after in pairwise(body):
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        if isinstance(target, ast.Name) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            found[target.id] = str(after.value.value).partition("\n")[0]
    return found


def _reference(room: str, about: str) -> str:
    blocks = []
    for name in _modules(room):
        blocks.append(f"::: {name}\n")
        if (ROOT / name.replace(".", "/")).is_dir():  # names that it only imports are documented where they are defined
            blocks[-1] += f"    options:\n      members: {json.dumps(_defined(name))}\n"
    return _page(f"# {room}", f"{about}.", "\n".join(blocks))


def _defined(package: str) -> list[str]:
    """The public classes, functions and documented constants that a package itself defines."""
    body = ast.parse((ROOT / package.replace(".", "/") / "__init__.py").read_text(encoding="utf-8")).body
    names = [node.name for node in body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
    return [name for name in (*names, *_constants(package)) if not name.startswith("_")]
