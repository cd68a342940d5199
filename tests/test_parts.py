"""What is compiled within a kernel is there for other kernels, and other processes."""

import os
import subprocess
import sys
from pathlib import Path

COUNTED = """
from slam_gym._parts import PartCompiler
compiled, compile = [], PartCompiler.compile_extra
PartCompiler.compile_extra = lambda self, function: (compiled.append(function.__name__), compile(self, function))[1]
"""
OUTER = "from tests.test_kernels import _twice; print(_twice(4.0), sorted(compiled))"
INNER = """
from tests.test_kernels import _sum_of_roots
print(_sum_of_roots(9.0, 2), compiled)
try:
    _sum_of_roots(-9.0, 2)
except ValueError as error:
    print(error)
"""


def test_what_one_process_has_compiled_within_a_kernel_another_one_links_into_others(tmp_path: Path) -> None:
    said = [
        subprocess.run(
            [sys.executable, "-c", COUNTED + code],
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}, cwd=Path(__file__).parents[1],
            capture_output=True, text=True, check=True,
        ).stdout
        for code in (OUTER, INNER)
    ]  # fmt: skip
    assert said == ["12.0 ['_root', '_sum_of_roots']\n", "6.0 []\nno root of a negative number\n"]
