"""Both pipelines run the same stages, depend on all code that these import, and keep photographs out of git."""

import functools
import re
import warnings
from pathlib import Path

import pytest
import yaml

from epiprior_lab.compute.source_graph import SOURCE, source_files
from epiprior_lab.params import load_params

ROOT = Path(__file__).parents[3]
PIPELINES = {"dvc.yaml": "params.yaml", "benchmarks/real/dvc.yaml": "benchmarks/real/params.yaml"}
STAGES = {
    (file, name): stage
    for file in PIPELINES
    for name, stage in yaml.safe_load((ROOT / file).read_text(encoding="utf-8"))["stages"].items()
}


@pytest.mark.parametrize(("file", "name"), STAGES)
def test_a_stage_depends_on_all_code_that_it_imports(file, name):
    module = re.search(r"python -m (epiprior_lab\.stages\.\w+)", STAGES[file, name]["cmd"])[1]
    stage = SOURCE / (module.replace(".", "/") + ".py")
    assert stage.is_file()
    deps = [ROOT / dep for dep in STAGES[file, name]["deps"] if dep.startswith("src/")]
    missing = [str(path) for path in sorted(source_files(stage)) if not any(path.is_relative_to(dep) for dep in deps)]
    assert missing == []


@pytest.mark.parametrize("file", PIPELINES)
def test_every_group_is_evaluated_and_reported(file):
    own = load_params(ROOT / PIPELINES[file]).evaluate
    stages = {name: stage for (where, name), stage in STAGES.items() if where == file}
    assert stages["evaluate"]["matrix"] == {"group": "${evaluate.groups}"}
    assert f"--params {PIPELINES[file]} --group ${{item.group}}" in stages["evaluate"]["cmd"]
    assert stages["evaluate"]["outs"] == [f"{own.out}/${{item.group}}"]
    read = {dep.removeprefix(f"{own.out}/") for dep in stages["report"]["deps"] if dep.startswith(f"{own.out}/")}
    assert read == set(own.groups)


@functools.cache
def photograph_stages():
    """Return DVC's own reading of the second pipeline, matrices written out."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from dvc.repo import Repo

        with Repo(str(ROOT)) as repo:
            return [stage for stage in repo.index.stages if stage.path_in_repo == "benchmarks/real/dvc.yaml"]


def test_paths_are_from_the_root_and_photographs_stay_out_of_git():
    stages = photograph_stages()
    assert len(stages) == 2 * len(load_params(ROOT / "benchmarks/real/params.yaml").evaluate.groups) + 2
    assert {Path(stage.wdir) for stage in stages} == {ROOT}
    for stage in stages:
        for out in stage.outs:
            path = Path(out.fs_path)
            assert path.is_relative_to(ROOT / ("data" if out.use_cache else "reports/real"))
    (gallery,) = (out for stage in stages for out in stage.outs if out.fs_path.endswith("photographs-gallery"))
    assert gallery.use_cache
    assert "/data/" in (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()


def test_stages_read_what_is_committed_or_what_others_write():
    written = {Path(out.fs_path) for stage in photograph_stages() for out in stage.outs}
    for stage in photograph_stages():
        for dep in stage.deps:
            path = Path(dep.fs_path)
            assert "timings" not in path.parts
            if path not in written and not path.is_relative_to(ROOT / "data" / "real"):
                committed = (ROOT / "src", ROOT / "models", ROOT / "benchmarks")
                assert any(path.is_relative_to(folder) for folder in committed), path
