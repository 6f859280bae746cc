"""What has to agree between files: the lock, versions, the pipeline, its parameters and its code."""

import ast
import functools
import importlib.metadata
import re
import tomllib
import warnings
from pathlib import Path

import pytest
import yaml

from epiprior_lab.compute.source_graph import SOURCE, source_files

ROOT = Path(__file__).parents[1]
PIPELINE = yaml.safe_load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]
PARAMS = yaml.safe_load((ROOT / "params.yaml").read_text(encoding="utf-8"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


# --- the environment


LOCKS = ("requirements.lock", "requirements-lowest.lock")


def locked(lock):
    """Return the blocks of a lock: requirement line and its hashes."""
    text = (ROOT / lock).read_text(encoding="utf-8")
    blocks = re.split(r"\n(?=[a-z0-9])", text.strip(), flags=re.IGNORECASE)
    return {re.split(r"[=\[ ]", block, maxsplit=1)[0].lower(): block for block in blocks}


def declared():
    """Return the dependencies of the project and of its extras: name and lower bound."""
    extras = PROJECT["optional-dependencies"]
    lines = [*PROJECT["dependencies"], *(line for name in extras for line in extras[name])]
    pairs = [re.match(r"([\w.-]+)>=([\d.]+)", line) for line in lines if not line.startswith("epiprior[")]
    return {pair[1].lower().replace("_", "-"): pair[2] for pair in pairs}


@pytest.mark.parametrize("lock", LOCKS)
def test_every_locked_requirement_is_pinned_and_hashed(lock):
    blocks = locked(lock)
    assert len(blocks) > 100
    for name, block in blocks.items():
        assert re.match(r"[\w.-]+(\[[\w,-]+\])?==\S+", block), name
        assert "--hash=sha256:" in block, name


@pytest.mark.parametrize("lock", LOCKS)
def test_the_lock_holds_no_address(lock):
    text = (ROOT / lock).read_text(encoding="utf-8")
    assert not re.search(r"https?://|--(extra-)?index-url|--find-links|file:", text)


@pytest.mark.parametrize("lock", LOCKS)
def test_the_lock_holds_every_declared_dependency(lock):
    assert declared().keys() <= locked(lock).keys()


def test_the_lowest_lock_holds_the_lower_bounds():
    """Write both locks anew by `make lock` after a change of bounds."""
    blocks = locked("requirements-lowest.lock")
    for name, bound in declared().items():
        pinned = re.search(r"==([\d.]+)", blocks[name])[1].split(".")
        wanted = bound.split(".")
        assert pinned[: len(wanted)] == wanted, name


def test_every_dependency_has_a_lower_bound():
    for line in PROJECT["dependencies"]:
        assert ">=" in line, line
        assert ",<" in line, line


def test_the_installed_version_is_the_projects():
    assert importlib.metadata.version("epiprior") == PROJECT["version"]


def test_the_license_is_the_declared_one():
    assert PROJECT["license"] == "BSD-3-Clause"
    assert (ROOT / "LICENSE").read_text(encoding="utf-8").startswith("BSD 3-Clause License")


# --- the pipeline: a stage lists all code that it imports, and the parameters that it reads


def stage_file(name):
    module = re.search(r"python -m (epiprior_lab\.stages\.\w+)", PIPELINE[name]["cmd"])[1]
    return SOURCE / (module.replace(".", "/") + ".py")


def code_deps(name):
    return [ROOT / dep for dep in PIPELINE[name]["deps"] if dep.startswith("src/")]


@pytest.mark.parametrize("name", PIPELINE)
def test_a_stage_depends_on_all_code_that_it_imports(name):
    deps = code_deps(name)
    missing = [
        file.relative_to(ROOT).as_posix()
        for file in sorted(source_files(stage_file(name)))
        if not any(file.is_relative_to(dep) for dep in deps)
    ]
    assert missing == [], f"stage {name} imports these, but does not list them as deps"


@pytest.mark.parametrize("name", PIPELINE)
def test_a_stage_depends_on_no_other_code(name):
    files = source_files(stage_file(name))
    idle = [str(dep) for dep in code_deps(name) if not any(file.is_relative_to(dep) for file in files)]
    assert idle == [], f"stage {name} lists these deps, but does not import them"


@pytest.mark.parametrize("name", PIPELINE)
def test_a_stage_lists_the_parameters_that_it_reads(name):
    listed = {entry.split(".")[0] for entry in PIPELINE[name].get("params", [])}
    read = set()
    for node in ast.walk(ast.parse(stage_file(name).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute) and node.attr in PARAMS:
            owner = node.value
            if isinstance(owner, ast.Name) and owner.id == "params":
                read.add(node.attr)
            elif isinstance(owner, ast.Call) and isinstance(owner.func, ast.Name):
                read |= {node.attr} if owner.func.id == "load_params" else set()
    assert read == listed


def test_no_parameter_is_dead():
    """Every key of params.yaml is named somewhere beside its declaration, in code or as a matrix of the pipeline."""
    files = [path for path in (SOURCE / "epiprior_lab").rglob("*.py") if path.name != "params.py"]
    text = "\n".join(path.read_text(encoding="utf-8") for path in [*files, ROOT / "dvc.yaml"])
    words = set(re.findall(r"\w+", text))
    keys = {key for section in PARAMS.values() for key in section}
    assert keys <= words


@functools.cache
def resolved():
    """Return DVC's own reading of the pipeline, matrices written out."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from dvc.repo import Repo

        with Repo(str(ROOT)) as repo:
            return [stage for stage in repo.index.stages if stage.path_in_repo == "dvc.yaml"]


def test_stages_read_exactly_what_others_write():
    """A dependency on a part or a parent of an output could not be compared in a clone without data."""
    written = {Path(out.fs_path) for stage in resolved() for out in stage.outs}
    for stage in resolved():
        for path in {Path(dep.fs_path) for dep in stage.deps} - written:
            touched = [out for out in written if out.is_relative_to(path) or path.is_relative_to(out)]
            assert touched == [], f"{stage.name}: {path}"


def test_timings_feed_only_the_last_stage():
    readers = {
        stage.name
        for stage in resolved()
        for dep in stage.deps
        if Path(dep.fs_path).is_relative_to(ROOT / "data" / "timings")
    }
    assert readers <= {"overhead"}
    outs = {out.fs_path for stage in resolved() if stage.name == "overhead" for out in stage.outs}
    assert not any(dep.fs_path in outs for stage in resolved() for dep in stage.deps)


def test_only_results_in_git_are_outside_the_cache():
    uncached = {
        Path(out.fs_path).relative_to(ROOT).parts[0] for stage in resolved() for out in stage.outs if not out.use_cache
    }
    assert uncached == {"models", "reports"}
    assert all(
        Path(out.fs_path).is_relative_to(ROOT / "data") for stage in resolved() for out in stage.outs if out.use_cache
    )


def test_nothing_phones_home():
    config = (ROOT / ".dvc" / "config").read_text(encoding="utf-8")
    assert re.search(r"analytics\s*=\s*false", config)
    assert "remote" not in config
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for name in ("DVC_NO_ANALYTICS := 1", "MLFLOW_DISABLE_TELEMETRY := true", "DO_NOT_TRACK := 1"):
        assert f"export {name}" in makefile
    assert "export ORT_DISABLE_TELEMETRY := 1" in makefile
