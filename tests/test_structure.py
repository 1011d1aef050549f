"""Rules of the architecture that a reader relies on."""

import ast
import tracemalloc
from pathlib import Path

import pytest
from helpers import DryRun

import mip_rt
from mip_rt import compiled
from mip_rt.supervisor import State

PACKAGE = Path(mip_rt.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))


def imports(path):
    """Names of mip_rt modules that a file imports, anywhere in it, with whether inside a function."""
    tree = ast.parse(path.read_text())
    inside = {id(node) for f in ast.walk(tree) if isinstance(f, ast.FunctionDef) for node in ast.walk(f)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("mip_rt"):
            for alias in node.names:
                yield f"{node.module}.{alias.name}", id(node) in inside
        elif isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, id(node) in inside


def part(path):
    relative = path.relative_to(PACKAGE)
    return relative.parts[0] if len(relative.parts) > 1 else relative.stem


def test_models_estimators_controllers_know_no_io_clock_or_configuration():
    for path in FILES:
        if part(path) in ("models", "estimators", "controllers"):
            for name, _ in imports(path):
                if name.startswith("mip_rt"):
                    assert name.split(".")[1] in ("models", "estimators", "controllers", "compiled"), (path, name)
                assert name.split(".")[0] not in ("os", "time", "socket", "select", "yaml"), (path, name)


def test_nothing_but_cli_and_tests_imports_the_fakes_or_the_lab():
    for path in FILES:
        if part(path) in ("fake", "lab"):
            continue
        for name, inside in imports(path):
            if name.startswith(("mip_rt.fake", "mip_rt.lab")):
                assert path.name in ("cli.py", "run.py", "scenario.py", "open_patient.py") and inside, (path, name)


def test_hardware_knows_no_robot():
    for path in FILES:
        if part(path) == "hardware":
            for name, _ in imports(path):
                assert not name.startswith(("mip_rt.robots", "mip_rt.estimators", "mip_rt.controllers", "mip_rt.models")), (path, name)


def test_only_one_module_imports_numba():
    for path in FILES:
        if path.name != "compiled.py" and "numba" in path.read_text():
            for name, _ in imports(path):
                assert name.split(".")[0] != "numba" or path.name == "rows.py", path


def test_the_loop_neither_prints_nor_formats_nor_logs():
    text = (PACKAGE / "loop.py").read_text()
    (tree,) = (node for node in ast.parse(text).body if isinstance(node, ast.ClassDef))
    called = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    assert not called & {"print", "open", "list", "dict", "sorted"}
    assert not [node for node in ast.walk(tree) if isinstance(node, (ast.JoinedStr, ast.ListComp, ast.DictComp))]
    assert "logging" not in text and len(text.splitlines()) <= 150


def test_every_file_compiled_code_can_reach_is_in_the_cache_key():
    hashed = set(compiled.source_files())
    for path in hashed:
        if "njit" not in path.read_text():
            continue
        for name, _ in imports(path):
            if name.startswith("mip_rt."):
                parts = name.split(".")[1:]
                for depth in (len(parts), len(parts) - 1):
                    file = PACKAGE.joinpath(*parts[:depth]).with_suffix(".py")
                    if depth and file.exists():
                        assert file in hashed, (path, file)


def test_no_allocation_remains_from_10000_ticks(tmp_path):
    """tracemalloc over 10,000 ticks of the loop: what the tick allocates is freed within it, nothing grows."""
    with DryRun(tmp_path) as dry:
        dry.until(lambda: dry.state is State.BALANCING)
        loop = dry.session.loop
        for _ in range(500):
            loop.tick()
        only = [tracemalloc.Filter(True, str(PACKAGE / "*")), tracemalloc.Filter(False, str(PACKAGE / "fake" / "*"))]
        tracemalloc.start()
        before = tracemalloc.take_snapshot().filter_traces(only)
        for _ in range(10000):
            loop.tick()
        after = tracemalloc.take_snapshot().filter_traces(only)
        tracemalloc.stop()
        grown = sum(difference.size_diff for difference in after.compare_to(before, "lineno") if difference.size_diff > 0)
        assert grown < 4096 and dry.state is State.BALANCING


INHERITED = {"describe", "convert"}  # documented once, in the base class


def test_everything_public_has_a_docstring():
    missing = []
    for path in FILES:
        tree = ast.parse(path.read_text())
        missing += [] if ast.get_docstring(tree) else [path.name]
        hidden = {id(n) for c in ast.walk(tree) if isinstance(c, (ast.ClassDef, ast.FunctionDef)) and c.name.startswith("_") for n in ast.walk(c)}
        inner = {id(n) for f in ast.walk(tree) if isinstance(f, ast.FunctionDef) for n in ast.walk(f) if n is not f}
        for node in ast.walk(tree):
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and id(node) not in hidden | inner and node.name not in INHERITED:
                missing += [] if ast.get_docstring(node) else [f"{path.name}:{node.name}"]
    assert missing == []


@pytest.mark.slow
def test_an_edit_in_another_file_is_not_answered_with_old_machine_code(tmp_path):
    """The trap of numba's disk cache: the caller's file is unchanged, the callee's constant is not."""
    import os
    import shutil
    import subprocess
    import sys

    shutil.copytree(PACKAGE, tmp_path / "mip_rt", ignore=shutil.ignore_patterns("__pycache__"))
    program = "from mip_rt.models import friction\nfrom mip_rt.controllers.wheel_drive import compensation\n" \
              "from mip_rt.compiled import njit, CACHE_FOLDER\nimport caller\nprint(CACHE_FOLDER, caller.f(1.0))"  # fmt: skip
    caller = "from mip_rt.compiled import njit\nfrom mip_rt.models.friction import torque\n@njit\ndef f(x):\n    return torque(x, 1.0, 0.0)\n"
    (tmp_path / "mip_rt/models/caller.py").write_text(caller)
    environment = {**os.environ, "MIP_RT_CACHE": str(tmp_path / "cache"), "PYTHONPATH": f"{tmp_path}:{tmp_path}/mip_rt/models"}

    def run():
        result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment, cwd=tmp_path, check=True)
        folder, value = result.stdout.split()
        return folder, float(value)

    first = run()
    assert run() == first
    file = tmp_path / "mip_rt/models/friction.py"
    file.write_text(file.read_text().replace("SMOOTHING_RAD_S = 0.1", "SMOOTHING_RAD_S = 2.0"))
    second = run()
    assert second[0] != first[0] and second[1] != first[1]
