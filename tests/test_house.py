"""What has to agree between files: locks, versions, both pipelines, their parameters and their code."""

import ast
import functools
import importlib.metadata
import re
import tomllib
import warnings
from pathlib import Path

import pytest
import yaml

from epiprior_lab.bags.params import PATH as BAGS
from epiprior_lab.bags.params import load_sfm_params
from epiprior_lab.compute import source_graph
from epiprior_lab.compute.source_graph import SOURCE, source_files
from epiprior_lab.params import PHOTOGRAPHS, STUDY, load_params

ROOT = Path(__file__).parents[1]
EVALUATIONS = {"dvc.yaml": STUDY, "benchmarks/real/dvc.yaml": PHOTOGRAPHS}
PIPELINES = EVALUATIONS | {"benchmarks/sfm/dvc.yaml": BAGS}
STAGES = [
    (pipeline, name, stage)
    for pipeline in PIPELINES
    for name, stage in yaml.safe_load((ROOT / pipeline).read_text(encoding="utf-8"))["stages"].items()
]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


LOCKS = ("requirements.lock", "requirements-lowest.lock")


def locked(lock):
    blocks = re.split(r"\n(?=[a-z0-9])", (ROOT / lock).read_text(encoding="utf-8").strip(), flags=re.IGNORECASE)
    return {re.split(r"[=\[ ]", block, maxsplit=1)[0].lower(): block for block in blocks}


def declared():
    extras = PROJECT["optional-dependencies"]
    lines = [*PROJECT["dependencies"], *(line for name in extras for line in extras[name])]
    pairs = [re.match(r"([\w.-]+)>=([\d.]+)", line) for line in lines if not line.startswith("epiprior[")]
    return {pair[1].lower().replace("_", "-"): pair[2] for pair in pairs}


@pytest.mark.parametrize("lock", LOCKS)
def test_every_dependency_is_bounded_pinned_and_hashed_and_no_lock_holds_an_address(lock):
    blocks = locked(lock)
    assert all(",<" in line for line in PROJECT["dependencies"])
    assert declared().keys() <= blocks.keys()
    for name, block in blocks.items():
        assert re.match(r"[\w.-]+(\[[\w,-]+\])?==\S+", block), name
        assert "--hash=sha256:" in block, name
    text = (ROOT / lock).read_text(encoding="utf-8")
    assert not re.search(r"https?://|--(extra-)?index-url|--find-links|file:", text)


def test_the_lowest_lock_holds_the_lower_bounds_and_the_installed_version_is_the_projects():
    """Write both locks anew by `make lock` after a change of bounds."""
    blocks = locked("requirements-lowest.lock")
    for name, bound in declared().items():
        pinned = re.search(r"==([\d.]+)", blocks[name])[1].split(".")
        wanted = bound.split(".")
        assert pinned[: len(wanted)] == wanted, name
    assert importlib.metadata.version("epiprior") == PROJECT["version"]


# --- the pipelines: a stage depends on all code that it imports, and on the parameters that it reads


@pytest.fixture(scope="module", autouse=True)
def each_file_is_parsed_once():
    imported = source_graph._imported
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(source_graph, "_imported", functools.cache(lambda *where: tuple(imported(*where))))
        yield


def stage_file(stage):
    return SOURCE / (re.search(r"python -m (epiprior_lab\.stages\.\w+)", stage["cmd"])[1].replace(".", "/") + ".py")


@functools.cache
def has_code(file):
    return len(ast.parse(file.read_bytes()).body) > 1


@pytest.mark.parametrize(("pipeline", "name", "stage"), STAGES)
def test_a_stage_depends_on_all_code_that_it_imports(pipeline, name, stage):
    deps = [ROOT / dep for dep in stage["deps"]]
    files = [file for file in sorted(source_files(stage_file(stage))) if has_code(file)]
    missing = [file for file in files if not any(file.is_relative_to(dep) for dep in deps)]
    assert missing == [], f"stage {name} of {pipeline} imports these, but does not list their folders"


@pytest.mark.parametrize(("pipeline", "name", "stage"), STAGES)
def test_a_stage_lists_the_sections_of_parameters_that_it_reads(pipeline, name, stage):
    file = PIPELINES[pipeline]
    listed = stage["params"] if file == STUDY else stage["params"][0][str(file)]
    read = set()
    for node in ast.walk(ast.parse(stage_file(stage).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute) and re.fullmatch(r"params|load_\w+\(.*\)", ast.unparse(node.value)):
            read.add(node.attr)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "make_protocol":
            read |= {"evaluate", "measures", "truth"}
    params = load_sfm_params(ROOT / file) if file == BAGS else load_params(ROOT / file)
    assert sorted(read & params.__dataclass_fields__.keys()) == sorted(listed), f"{pipeline}: {name}"


@functools.cache
def resolved():
    """Return DVC's own reading of all pipelines, matrices written out."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from dvc.repo import Repo

        with Repo(str(ROOT)) as repo:
            return [stage for stage in repo.index.stages if stage.path_in_repo in PIPELINES]


def test_every_group_is_evaluated_and_reported():
    for pipeline, file in EVALUATIONS.items():
        stages = {stage.name: stage for stage in resolved() if stage.path_in_repo == pipeline}
        own = load_params(ROOT / file).evaluate
        folders = {str(ROOT / own.out / group) for group in own.groups}
        assert {out.fs_path for name, s in stages.items() if name.startswith("evaluate@") for out in s.outs} == folders
        assert {dep.fs_path for dep in stages["report"].deps if own.out in dep.fs_path} == folders


def test_stages_read_what_is_committed_or_written_but_no_times_and_only_results_in_git_are_outside_the_cache():
    """A dependency on a part or a parent of an output could not be compared in a clone without data."""
    written = {Path(out.fs_path) for stage in resolved() for out in stage.outs}
    for stage in resolved():
        for path in {Path(dep.fs_path) for dep in stage.deps} - written:
            touched = [out for out in written if out.is_relative_to(path) or path.is_relative_to(out)]
            assert touched == [], f"{stage.name}: {path}"
            committed = not path.is_relative_to(ROOT / "data")
            assert committed or path.is_relative_to(ROOT / "data" / "real"), f"{stage.name}: {path}"
    assert not [dep.fs_path for stage in resolved() for dep in stage.deps if "timings" in Path(dep.fs_path).parts]
    # Pictures of photographs stay in data/, which git ignores.
    for stage in resolved():
        assert Path(stage.wdir) == ROOT
        for out in stage.outs:
            folder = Path(out.fs_path).relative_to(ROOT).parts[0]
            assert folder in ({"data"} if out.use_cache else {"models", "reports"}), out.fs_path
    assert "/data/" in (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
