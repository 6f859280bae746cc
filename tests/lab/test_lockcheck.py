"""A pipeline of two stages, run by DVC itself, then changed in every way that the check has to notice."""

import shutil
import warnings

import pytest
from typer.testing import CliRunner

from command_line import run_python
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
    commands = (["init", "--no-scm", "-q"], ["repro", "-q"], ["repro", "-q", "benchmarks/real/dvc.yaml"])
    code = f"import os; os.chdir({str(folder)!r}); from dvc.cli import main; assert not any(map(main, {commands}))"
    run_python(code, DVC_SITE_CACHE_DIR=str(folder / ".site"), PYTHONWARNINGS="ignore")
    shutil.rmtree(folder / "data")
    shutil.rmtree(folder / ".dvc" / "cache")
    return folder


@pytest.fixture
def clone(committed, tmp_path, monkeypatch):
    monkeypatch.setenv("DVC_SITE_CACHE_DIR", str(tmp_path / ".site"))
    return shutil.copytree(committed, tmp_path / "clone")


def check(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of DVC's own packages
        done = CliRunner().invoke(app, ["check-lock", "--root", str(folder)])
    assert isinstance(done.exception, SystemExit | LockError | None)
    return done.exit_code, f"{done.output}{done.exception}"


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


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
        ("dvc.yaml", "stages:", "stages: [", ["DVC cannot read the pipeline"]),
        ("dvc.lock", None, None, ["dvc.lock: no such file"]),
        ("model", None, None, ["model: deleted"]),
        ("benchmarks/real/dvc.lock", None, None, ["photographs were not evaluated"]),
    ],
)
def test_what_differs_is_named_with_its_stage(file, old, new, named, clone):
    if old is None:
        (clone / file).rename(clone.parent / "moved")
    else:
        edit(clone / file, old, new)
    code, output = check(clone)
    assert all(name in output for name in named), output
    assert code == (file != "benchmarks/real/dvc.lock")


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
