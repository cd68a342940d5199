"""The notebooks run from top to bottom, and what they show is what their text says."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LARGEST = 1_500_000  # [bytes]


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def committed(request: pytest.FixtureRequest) -> Any:
    return nbformat.read(request.param, as_version=4)


@pytest.fixture
def headless(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")


def executed(name: str) -> Any:
    """The notebook, run afresh; nbclient raises where a cell does."""
    notebook = nbformat.read(ROOT / "notebooks" / name, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = [], None
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(ROOT)}}).execute()
    return notebook


def outputs(notebook: Any) -> Iterator[Any]:
    for cell in notebook.cells:
        yield from cell.get("outputs", [])


def text(notebook: Any) -> str:
    """Everything that the cells printed or showed as a table."""
    parts = []
    for output in outputs(notebook):
        data = output.get("data", {})
        parts.append(output.get("text", "") or data.get("text/markdown", ""))
    return "\n".join(parts)


def pictures(notebook: Any) -> int:
    return sum("image/png" in output.get("data", {}) for output in outputs(notebook))


def row(shown: str, name: str) -> list[float]:
    """Numbers in the last table row of that name that has any."""
    rows = [line.removeprefix(f"| {name} |") for line in shown.splitlines() if line.startswith(f"| {name} |")]
    return [float(number) for number in re.findall(r"-?\d+\.?\d*", [row for row in rows if re.search(r"\d", row)][-1])]


def test_committed_with_their_outputs_nothing_of_a_machine_and_running_from_a_wheel(committed: Any) -> None:
    assert len(nbformat.writes(committed)) < LARGEST
    assert committed.metadata.kernelspec.name == "python3"
    assert pictures(committed) >= 3
    words = "\n".join(cell.source for cell in committed.cells) + text(committed)
    assert not re.search(r"/(home|root|Users|tmp)/|[A-Z]:\\", words) and str(ROOT) not in words
    for cell in committed.cells:
        assert cell.cell_type != "code" or cell.execution_count is not None
    for output in outputs(committed):
        assert output.output_type != "error" and output.get("name") != "stderr"
    code = "\n".join(cell.source for cell in committed.cells if cell.cell_type == "code")
    assert not re.search(r"^ *(from|import) (agents|benchmarks|tests)\b", code, re.MULTILINE)


@pytest.mark.parametrize("path", NOTEBOOKS[:5], ids=lambda path: path.stem)
def test_a_notebook_opens_with_what_comes_and_ends_with_exercises(path: Path) -> None:
    cells = nbformat.read(path, as_version=4).cells
    assert "**What you will see**" in cells[0].source and "**It takes**" in cells[0].source
    assert cells[-1].source.count("<details><summary>Solution of") == 2 or "## Where next" in cells[-1].source


@pytest.mark.slow
def test_quickstart(headless: None) -> None:
    notebook = executed("01_quickstart.ipynb")
    shown = text(notebook)
    assert pictures(notebook) == 3
    assert re.search(r"goal \d+ took \d+ ticks and earned 0\.\d+", shown) and "a legal sample" in shown
    errors = dict(re.findall(r"(at_random|greedy) +map error (\d\.\d+),", shown))
    assert float(errors["greedy"]) < float(errors["at_random"])
    found = {
        name: (float(p), float(e))
        for name, p, e in re.findall(r"(nearest|jcbb) +precision (\d\.\d+).*?error (\d\.\d+)", shown)
    }
    assert found["nearest"][0] < found["jcbb"][0] and found["nearest"][1] > found["jcbb"][1]


@pytest.mark.slow
def test_why_joint_compatibility(headless: None) -> None:
    notebook = executed("02_why_joint_compatibility.ipynb")
    shown = text(notebook)
    assert pictures(notebook) == 7
    assert re.search(r"nearest neighbour +12 pairings, +8 right", shown)
    assert re.search(r"JCBB +12 pairings, 12 right", shown)
    for fate in ("visited", "incompatible", "cut by its bound"):
        assert fate in shown
    assert row(shown, "true association") == pytest.approx([88, 0, 0, 1, 1.0], abs=0.3)
    nearest, joint = row(shown, "nearest neighbour"), row(shown, "JCBB")
    assert nearest[0] >= 103 and 88 <= joint[0] <= 91
    assert nearest[1] >= 10 * joint[1] and joint[3] >= 0.98
    assert nearest[4] > 10 > 2 > joint[4]


@pytest.mark.slow
def test_locality(headless: None) -> None:
    notebook = executed("03_locality.ipynb")
    shown = text(notebook)
    assert pictures(notebook) == 5
    assert "125 = (4 + 1)³" in shown and "53 = 4 · 3² + 4 · 3 + 4 + 1" in shown and "False" not in shown
    assert row(shown, "covisibility")[3] < row(shown, "two hops")[3] < 0.5 * row(shown, "everything")[3]
    for search in ("GCBB", "RS"):  # nodes ∝ n^, pairing tests ∝ n^, each with its interval
        covisible, everything = row(shown, f"{search}, covisibility"), row(shown, f"{search}, everything")
        assert covisible[3] < 1.3 < 1.6 < everything[3]
    pairs = row(shown, "pairs")
    assert 8.0 < pairs[0] < 16.0 and pairs[3] < 1.0 and pairs[5] == 0.0
    assert row(shown, "the rule")[3] == 0


@pytest.mark.slow
def test_victoria_park(headless: None, data_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLAM_GYM_DATA", str(data_dir))
    monkeypatch.setenv("SLAM_GYM_SCANS", "1500")
    notebook = executed("04_victoria_park.ipynb")
    shown = text(notebook)
    assert pictures(notebook) == 7
    assert "1500 scans in 5 minutes" in shown
    nearest, joint = row(shown, "nearest neighbour, every 6"), row(shown, "JCBB, every 6")
    assert nearest[1] > 5 and nearest[4] > 100 and joint[1] == 0 and joint[4] < 30  # duplicates, wrong pairings
    assert joint[6] < 2.0 < nearest[6]
    assert row(shown, "JCBB, every 1")[6] == pytest.approx(row(shown, "nearest neighbour, every 1")[6], abs=0.1)
    assert re.search(r"nearest neighbour +11 pairings, +8 right", shown)
    assert re.search(r"JCBB +11 pairings, 11 right", shown)
    returns = [row(shown, name)[0] for name in ("nearest neighbour", "JCBB", "refuse everything", "true association")]
    assert returns[0] < returns[1] < returns[2] == 0.0 < 0.9 < returns[3]
    covisible, everything = row(shown, "covisibility"), row(shown, "everything")
    assert covisible[0] >= 20 and covisible[1] == everything[1] == 0 and covisible[3] < 0.5 * everything[3]
    standard, local_maps = row(shown, "standard EKF"), row(shown, "local maps, joined")
    assert standard[0] < 1.0 and local_maps[0] < 1.0 and standard[6] < local_maps[6]


@pytest.mark.slow
def test_victoria_park_without_its_data_says_where_to_get_it(headless: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SLAM_GYM_DATA", raising=False)
    notebook = executed("04_victoria_park.ipynb")
    shown = text(notebook)
    assert all(output.output_type == "stream" for output in outputs(notebook))
    assert "SLAM_GYM_DATA" in shown and "Cite: Guivant and Nebot" in shown and "the cells below do nothing" in shown
    assert "usyd.edu.au" in notebook.cells[0].source


@pytest.mark.slow
def test_drift(headless: None) -> None:
    notebook = executed("05_drift.ipynb")
    shown = text(notebook)
    assert pictures(notebook) == 6
    passes = [float(value) for value in re.findall(r"passes at 8°: ANEES (\d\.\d+)", shown)]
    assert passes[0] > 1.3 > 1.15 > max(passes[1:]) and min(passes) > 0.85
    wrong, measured = (int(n) for n in re.search(r"JCBB pairs (\d+) of (\d+) measurements wrongly", shown).groups())
    rows = re.findall(r"^ +\d+ +(right|WRONG|–) +(right|WRONG|–) +(right|WRONG|–) +\d\.\d\d$", shown, re.MULTILINE)
    assert len(rows) == measured and sum(row[0] == "WRONG" for row in rows) == wrong >= 1
    assert sum(row[2] == "right" for row in rows) > sum(row[0] == "right" for row in rows)
    alone, atlas = (float(e) for e in re.findall(r"(?:alone|map): map error (\d\.\d+),", shown))
    assert atlas < 0.7 * alone
    twice = [int(n) for n in re.findall(r"(\d+) features mapped twice", shown)]
    assert twice[1] <= 2 < 20 < twice[0]


@pytest.mark.slow
def test_learning(headless: None) -> None:
    notebook = executed("06_learning.ipynb")
    shown = text(notebook)
    assert pictures(notebook) == 3
    random, early, late = (row(shown, who) for who in ("random", "4 minutes", "16 minutes"))
    for drift in range(2):
        assert random[drift] < 0.0 and random[drift] < early[drift] and 0.3 < late[drift] < 1.0
    first, last = map(float, re.findall(r"earns (-?\d\.\d+) in the first third, (-?\d\.\d+) in the last", shown)[0])
    assert last > first  # a minute of training is seen
