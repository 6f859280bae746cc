"""The library stands alone: it loads nothing of the workspace, and none of its heavy dependencies; rooms in order."""

import ast
import json
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from command_line import run_python

SOURCE = Path(__file__).parents[1] / "src"
FORBIDDEN = "sklearn mlflow dvc pandas lightgbm matplotlib pycolmap poselib pydegensac joblib epiprior_lab"
EVERY_MODULE = """
import importlib, pkgutil, epiprior
for module in pkgutil.walk_packages(epiprior.__path__, "epiprior."):
    importlib.import_module(module.name)
"""


def test_a_fresh_interpreter_loads_nothing_of_the_workspace_and_public_names_stay_functions():
    """A module of the package that has a public function's name would hide it."""
    names = ("standard_matches", "rank_matches", "list_estimators", "estimate_fundamental")
    found = f"[[name.split('.')[0] for name in sys.modules], all(callable(getattr(epiprior, n)) for n in {names})]"
    loaded, functions = json.loads(run_python(f"{EVERY_MODULE}\nimport json, sys; print(json.dumps({found}))").stdout)
    assert "epiprior" in loaded
    assert set(loaded) & set(FORBIDDEN.split()) == set()
    assert functions


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="counts threads as Linux shows them")
def test_onnxruntime_has_no_thread_that_reports():
    """Besides reporting, it draws from the generator that pydegensac has seeded."""
    program = "import os; os.environ.pop('ORT_DISABLE_TELEMETRY', None); import epiprior.ranking.models\n"
    limits = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
    assert run_python(program + "print(len(os.listdir('/proc/self/task')))", **limits).stdout.strip() == "1"


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


def test_each_room_imports_only_rooms_before_it_and_no_modules_in_a_circle():
    for path in sorted((SOURCE / "epiprior").rglob("*.py")):
        assert not re.search(r"(import|from) epiprior_lab", path.read_text(encoding="utf-8")), path
        room = path.relative_to(SOURCE / "epiprior").parts[0].removesuffix(".py")
        if room == "__init__":
            continue
        for module in imported_modules(path):
            other = module.split(".")[0]
            if other in ROOMS:  # else a public name, of the package itself: commands use those
                assert ROOMS.index(other) <= ROOMS.index(room), f"{path.name} of {room} imports {module}"
    paths = [path for path in (SOURCE / "epiprior").rglob("*.py") if path.name != "__init__.py"]
    files = {".".join(path.relative_to(SOURCE / "epiprior").with_suffix("").parts): path for path in paths}
    graph = {}
    for name, path in files.items():
        modules = [f"{module}." for module in imported_modules(path)]
        graph[name] = {other for other in files if any(module.startswith(f"{other}.") for module in modules)}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the modules
