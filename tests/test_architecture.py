"""Dependencies point one way: types → geometry → { world | mapping, navigation, association } → slam → simulation →
{ rendering, envs } → agents."""

import ast
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import slam_gym

ROOT = Path(__file__).parents[1]
BASE = {"types", "geometry", "_jit", "_files", "validation", "weights"}
ESTIMATE = BASE | {"mapping", "navigation", "association"}
SIMULATION = ESTIMATE | {"world", "slam", "metrics", "recordings", "scenarios"}
ALLOWED = {
    "types": set(),
    "_jit": set(),
    "_files": set(),
    "weights": {"_files"},
    "geometry": {"types", "_jit"},
    "validation": {"types", "_jit"},
    "world": BASE,
    "mapping": BASE,
    "navigation": BASE | {"mapping"},
    "association": BASE | {"mapping", "navigation"},
    "metrics": ESTIMATE,
    "slam": ESTIMATE,
    "recordings": BASE,
    "scenarios": BASE | {"world", "mapping", "slam", "recordings"},
    "simulation": SIMULATION,
    "rendering": SIMULATION | {"simulation"},
    "envs": SIMULATION | {"simulation", "rendering"},
    "__main__": {"__init__", "_jit", "association", "recordings", "scenarios"},
    "__init__": SIMULATION,
}
"""The rooms that each room may import from, besides itself: always those below it."""


@cache  # every test asks for all files
def imports(path: Path) -> frozenset[str]:
    """Full names of the modules that a file imports, wherever in the file."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(names)


def part(module: str) -> str:
    """`slam_gym.mapping.ekf` → `mapping`; `slam_gym` itself → `__init__`."""
    return [*module.split("."), "__init__"][1]


FILES = sorted((ROOT / "slam_gym").rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_imports_point_one_way(path: Path) -> None:
    own = part(".".join(path.relative_to(ROOT).with_suffix("").parts))
    assert own in ALLOWED, f"{path}: a part of the package that the architecture does not know"
    used = {part(name) for name in imports(path) if name.split(".")[0] == "slam_gym"}
    assert used <= ALLOWED[own] | {own}, f"{path} imports {sorted(used - ALLOWED[own])}"


def test_no_modules_import_each_other_in_a_circle() -> None:
    paths = [*FILES, *sorted((ROOT / "agents").rglob("*.py"))]
    modules = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in paths}
    graph = {}
    for module, path in modules.items():
        names = {name if name in modules else name.rpartition(".")[0] for name in imports(path)}
        graph[module] = (names & modules.keys()) - {module}
    assert len(list(TopologicalSorter(graph).static_order())) == len(modules)  # CycleError names the circle


def test_only_physics_imports_pymunk() -> None:
    users = [path.name for path in FILES if any(name.split(".")[0] == "pymunk" for name in imports(path))]
    assert users == ["physics.py"]


def test_the_package_imports_no_agents_and_no_learning_library() -> None:
    for path in FILES:
        foreign = {name.split(".")[0] for name in imports(path)} & {"agents", "torch", "stable_baselines3", "tests"}
        assert not foreign, f"{path} imports {foreign}"


def test_truth_does_not_reach_the_estimate_side() -> None:
    for path in FILES:
        if part(".".join(path.relative_to(ROOT).with_suffix("").parts)) in ESTIMATE - BASE | {"slam"}:
            assert not any(name.endswith(".Truth") for name in imports(path)), path


# --- the public face: what it lists is there, and importing it is cheap -----------------------------------------------


def test_everything_listed_is_there_and_listed_once() -> None:
    assert len(set(slam_gym.__all__)) == len(slam_gym.__all__)
    for name in slam_gym.__all__:
        assert getattr(slam_gym, name) is not None
    assert set(slam_gym.__all__) <= set(dir(slam_gym))


def test_what_is_not_there_says_so() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        slam_gym.nonsense  # noqa: B018


def test_importing_the_package_imports_nothing_heavy() -> None:
    heavy = ("numba", "scipy", "pymunk", "torch", "pygame")
    code = f"import sys, slam_gym; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
