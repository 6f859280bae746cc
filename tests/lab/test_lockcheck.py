"""A pipeline of two stages, run by DVC itself, then changed in every way that the check has to notice."""

import os
import shutil
import subprocess
import sys
import warnings

import pytest
from typer.testing import CliRunner

from epiprior_lab.cli import app
from epiprior_lab.lockcheck import LockError

pytestmark = pytest.mark.slow

PIPELINE = """
stages:
  first:
    matrix:
      split: [train, test]
    cmd: mkdir -p data && cat code/step.py > data/${item.split}
    deps: [code]
    params: [first]
    outs: ["data/${item.split}"]
  last:
    cmd: mkdir model && cp data/train model/weights
    deps: [data/train, data/test]
    params: [last]
    outs: [model: {cache: false}]
"""
PHOTOGRAPHS = """
stages:
  report:
    cmd: mkdir -p reports/real && cat data/real/set/photo model/weights > reports/real/table
    wdir: ../..
    deps: [data/real/set, model]
    outs: [reports/real: {cache: false}]
"""
PARAMS = "first: 1\nlast: {low: 0.5, names: [a, b]}\nother: 1\n"


@pytest.fixture(scope="module")
def committed(tmp_path_factory):
    """Return a folder as a clean clone has it: code, parameters, lock, model; neither data nor cache."""
    folder = tmp_path_factory.mktemp("pipeline")
    for name, text in {
        "code/step.py": "x = 1\n",
        "dvc.yaml": PIPELINE,
        "params.yaml": PARAMS,
        ".dvcignore": "__pycache__/\n",
        "data/real/set/photo": "a photograph\n",
        "benchmarks/real/dvc.yaml": PHOTOGRAPHS,
    }.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    environment = os.environ | {"DVC_SITE_CACHE_DIR": str(folder / ".site")}
    for arguments in (["init", "--no-scm", "-q"], ["repro", "-q"], ["repro", "-q", "benchmarks/real/dvc.yaml"]):
        command = [sys.executable, "-W", "ignore", "-m", "dvc", *arguments]
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    shutil.rmtree(folder / "data")
    shutil.rmtree(folder / ".dvc" / "cache")
    return folder


@pytest.fixture
def clone(committed, tmp_path, monkeypatch):
    monkeypatch.setenv("DVC_SITE_CACHE_DIR", str(tmp_path / ".site"))
    return shutil.copytree(committed, tmp_path / "clone")


def check(folder):
    """Return the command's exit code and what it says."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of DVC's own packages
        done = CliRunner().invoke(app, ["check-lock", "--root", str(folder)])
    assert isinstance(done.exception, SystemExit | LockError | None)
    return done.exit_code, f"{done.output}{done.exception}"


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("damage", "code", "message"),
    [
        (lambda clone: (clone / "benchmarks/real/dvc.lock").unlink(), 0, "photographs were not evaluated"),
        (lambda clone: shutil.rmtree(clone / "model"), 1, "model: deleted"),
        (lambda clone: (clone / "dvc.lock").unlink(), 1, "dvc.lock: no such file"),
        (lambda clone: (clone / "dvc.yaml").write_text("stages: ["), 1, "DVC cannot read the pipeline"),
    ],
)
def test_files_that_are_missing_or_broken_are_one_clear_line(damage, code, message, clone):
    damage(clone)
    found, output = check(clone)
    assert found == code, output
    assert message in output


def test_a_clean_clone_passes_without_data(clone):
    (clone / "code" / "__pycache__").mkdir()
    (clone / "code" / "__pycache__" / "step.pyc").write_bytes(b"bytecode")
    edit(clone / "params.yaml", "other: 1", "other: 2")
    code, output = check(clone)
    assert code == 0, output
    assert "belongs" in output


@pytest.mark.parametrize(
    ("file", "old", "new", "named"),
    [
        ("code/step.py", "x = 1", "x = 2", ["first@train", "first@test", "code: modified"]),
        ("params.yaml", "0.5", "0.6", ["last", "params.yaml: last: modified"]),
        ("dvc.yaml", "cp data", "cp  data", ["last", "command: modified"]),
        ("dvc.yaml", "[train, test]", "[train, test, new]", ["first@new"]),
        ("model/weights", "x = 1", "x = 3", ["last", "model: modified"]),
        ("dvc.lock", "  last:", "  gone:", ["last", "gone", "in dvc.lock, not in dvc.yaml"]),
    ],
)
def test_what_differs_is_named_with_its_stage(file, old, new, named, clone):
    edit(clone / file, old, new)
    code, output = check(clone)
    assert all(name in output for name in named), output
    assert code == 1


def test_results_on_photographs_must_belong_to_the_models(clone):
    pipeline = clone / "benchmarks" / "real" / "dvc.yaml"
    edit(pipeline, "cat data", "cat  data")
    code, output = check(clone)
    assert code == 1
    assert "report: command: modified" in output
    assert "benchmarks/real/dvc.lock does not belong to this tree: run `make real DATA=FOLDER`" in output
    assert "\ndvc.lock belongs" in "\n" + output
    edit(pipeline, "cat  data", "cat data")
    edit(clone / "reports" / "real" / "table", "a photograph", "another")
    code, output = check(clone)
    assert code == 1
    assert "report: reports/real: modified" in output


def test_a_stage_must_have_read_what_its_predecessor_wrote(clone):
    lock = clone / "dvc.lock"
    written = next(line for line in lock.read_text().splitlines() if "md5:" in line and ".dir" not in line)
    head, tail = lock.read_text().split("\n  last:")
    lock.write_text(head + "\n  last:" + tail.replace(written.strip(), "md5: " + "f" * 32, 1))
    code, output = check(clone)
    assert code == 1
    assert "last" in output
    assert "the lock says that its stage wrote" in output
