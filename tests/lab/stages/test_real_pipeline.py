"""The second pipeline lists all code and parameters that its stages read, and keeps photographs out of git."""

import ast
import functools
import re
import warnings
from pathlib import Path

import pytest
import yaml

from epiprior_lab.compute.source_graph import SOURCE, source_files
from epiprior_lab.params import Params, load_params

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "benchmarks" / "real"
PARAMS = "benchmarks/real/params.yaml"
PIPELINE = yaml.safe_load((FOLDER / "dvc.yaml").read_text(encoding="utf-8"))["stages"]
BEHIND = {"inputs": {"evaluate", "peers"}, "real_hand_overs": {"evaluate", "peers", "whole"}}


def stage_file(name):
    module = re.search(r"python -m (epiprior_lab\.stages\.\w+)", PIPELINE[name]["cmd"])[1]
    return SOURCE / (module.replace(".", "/") + ".py")


def code_deps(name):
    return [ROOT / dep for dep in PIPELINE[name]["deps"] if dep.startswith("src/")]


def templates(file):
    """Return the folders of templates that a file hands to `jinja2.PackageLoader`."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("PackageLoader"):
            package, folder = (ast.literal_eval(value) for value in node.args)
            yield SOURCE / package.replace(".", "/") / folder


def read_by(name):
    """Return the source files of a stage and the folders of templates that these render."""
    files = source_files(stage_file(name))
    return files | {folder for file in files for folder in templates(file)}


@pytest.mark.parametrize("name", PIPELINE)
def test_a_stage_depends_on_all_code_that_it_imports_and_no_other(name):
    deps, files = code_deps(name), read_by(name)
    missing = [str(file) for file in sorted(files) if not any(file.is_relative_to(dep) for dep in deps)]
    assert missing == []
    assert [str(dep) for dep in deps if not any(file.is_relative_to(dep) for file in files)] == []


def test_templates_are_part_of_what_a_stage_reads():
    folder = SOURCE / "epiprior_lab" / "photographs" / "templates"
    assert (folder / "page.html.j2").is_file()
    assert folder in read_by("report")
    assert folder in code_deps("report")


@pytest.mark.parametrize("name", PIPELINE)
def test_a_stage_lists_the_parameters_that_it_reads(name):
    listed = {key for entry in PIPELINE[name]["params"] for key in entry[PARAMS]}
    read = set()
    for node in ast.walk(ast.parse(stage_file(name).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "params":
            read |= BEHIND.get(node.attr, {node.attr})
        elif isinstance(node, ast.Name):
            read |= BEHIND.get(node.id, set()) if node.id == "real_hand_overs" else set()
    assert read == listed
    assert read <= Params.__dataclass_fields__.keys()


def test_every_set_is_evaluated_and_reported():
    sets = set(load_params(ROOT / PARAMS).evaluate.groups)
    assert PIPELINE["evaluate"]["matrix"] == PIPELINE["peers"]["matrix"] == {"set": "${sets}"}
    for name in ("report", "overhead"):
        assert {dep.removeprefix("data/real/") for dep in PIPELINE[name]["deps"] if "data/real/" in dep} == sets
    read = {dep.removeprefix("data/photographs/") for dep in PIPELINE["report"]["deps"] if "data/photographs/" in dep}
    assert read == sets


@functools.cache
def resolved():
    """Return DVC's own reading of the pipeline, matrices written out."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from dvc.repo import Repo

        with Repo(str(ROOT)) as repo:
            return [stage for stage in repo.index.stages if stage.path_in_repo == "benchmarks/real/dvc.yaml"]


def test_paths_are_from_the_root_and_photographs_stay_out_of_git():
    stages = resolved()
    assert len(stages) == 2 * len(load_params(ROOT / PARAMS).evaluate.groups) + 2
    assert {Path(stage.wdir) for stage in stages} == {ROOT}
    for stage in stages:
        for out in stage.outs:
            path = Path(out.fs_path)
            assert path.is_relative_to(ROOT / ("data" if out.use_cache else "reports/real"))
    (gallery,) = (out for stage in stages for out in stage.outs if out.fs_path.endswith("photographs-gallery"))
    assert gallery.use_cache
    assert "/data/" in (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()


def test_stages_read_what_is_committed_or_what_others_write():
    written = {Path(out.fs_path) for stage in resolved() for out in stage.outs}
    for stage in resolved():
        for dep in stage.deps:
            path = Path(dep.fs_path)
            assert "timings" not in path.parts
            if path not in written and not path.is_relative_to(ROOT / "data" / "real"):
                committed = (ROOT / "src", ROOT / "models", FOLDER)
                assert any(path.is_relative_to(folder) for folder in committed), path


def test_one_line_says_what_to_do_without_data():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert "link-sets $(DATA)" in makefile
    assert "dvc repro --single-item" in makefile
