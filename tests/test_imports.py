"""The library stands alone: it loads nothing of the workspace, and none of its heavy dependencies; rooms in order."""

import ast
import json
import os
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src"
FORBIDDEN = "sklearn mlflow dvc pandas lightgbm matplotlib pycolmap poselib pydegensac joblib epiprior_lab"
EVERY_MODULE = """
import importlib, pkgutil, epiprior
for module in pkgutil.walk_packages(epiprior.__path__, "epiprior."):
    importlib.import_module(module.name)
"""


@pytest.mark.parametrize("program", ["import epiprior", EVERY_MODULE], ids=["package", "every module"])
def test_a_fresh_interpreter_loads_nothing_of_the_workspace(program):
    program += "\nimport json, sys; print(json.dumps(sorted({name.split('.')[0] for name in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = set(json.loads(done.stdout))
    assert "epiprior" in loaded
    assert loaded & set(FORBIDDEN.split()) == set()


def test_no_module_of_the_library_mentions_the_workspace_in_an_import():
    for path in sorted((SOURCE / "epiprior").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.split(".")[0] == "epiprior_lab" for name in names), path


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="counts threads as Linux shows them")
def test_onnxruntime_has_no_thread_that_reports():
    """Besides reporting, it draws from the generator that pydegensac has seeded."""
    program = "import os, epiprior.ranking.models; print(len(os.listdir('/proc/self/task')))"
    limits = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
    environment = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"} | limits
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.strip() == "1"


ORDER = "errors settings_file kernels types geometry presets features matching ranking verification estimators rank"
ROOMS = f"{ORDER} two_view explain io draw collection commands cli".split()


def imported_modules(path):
    """Return the modules of the library that a file imports, wherever in the file; not those for type checkers."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "epiprior":
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name.removeprefix("epiprior.") for name in names)


def test_each_room_imports_only_rooms_before_it():
    for path in sorted((SOURCE / "epiprior").rglob("*.py")):
        room = path.relative_to(SOURCE / "epiprior").parts[0].removesuffix(".py")
        if room == "__init__":
            continue
        for module in imported_modules(path):
            other = module.split(".")[0]
            if other in ROOMS:  # else a public name, of the package itself: commands use those
                assert ROOMS.index(other) <= ROOMS.index(room), f"{path.name} of {room} imports {module}"


def test_no_circle_between_modules():
    files = {
        ".".join(path.relative_to(SOURCE / "epiprior").with_suffix("").parts): path
        for path in (SOURCE / "epiprior").rglob("*.py")
        if path.name != "__init__.py"
    }
    graph = {
        name: {other for other in files for module in imported_modules(path) if f"{module}.".startswith(f"{other}.")}
        for name, path in files.items()
    }
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the modules
