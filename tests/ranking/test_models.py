import hashlib
import json
import re
import shutil
from functools import reduce
from operator import getitem
from pathlib import Path

import numpy as np
import pytest
from scipy.special import expit

from calls import refused
from epiprior import settings_file
from epiprior.errors import FeatureError, ModelError
from epiprior.presets import DEFAULT
from epiprior.ranking.models import calibrate, find_model, load_model
from tiny_model import MATCH_WEIGHTS, logistic, make_model

WIDTH, PLACED = len(DEFAULT.match_columns), DEFAULT.match_columns[2]
PLACE = np.arange(5 * WIDTH).reshape(5, WIDTH) == 3 * WIDTH + 2


@pytest.fixture
def folder(tmp_path):
    return make_model(tmp_path / "default")


def rows(count, width=WIDTH, seed=0):
    return np.random.default_rng(seed).normal(size=(count, width)).astype(np.float32)


def edit(folder, **entries):
    """Change entries of the manifest; None removes one, and a dotted key goes down."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    for key, value in entries.items():
        *above, last = key.split("__")
        section = reduce(getitem, above, manifest)
        section[last] = value
        if value is None:
            del section[last]
    path.write_text(json.dumps(manifest))


def test_probabilities_are_calibrated_strictly_increasing(folder):
    X = rows(1000)
    logit = np.clip(X @ np.array([MATCH_WEIGHTS.get(name, 0.0) for name in DEFAULT.match_columns]) - 1.0, -16, 16)
    edit(folder, match__calibration={"a": 0.5, "b": -0.25})
    probability = load_model(folder).match(X)
    assert probability.dtype == np.float64
    middle = np.abs(logit) < 8
    np.testing.assert_allclose(probability[middle], expit(0.5 * logit - 0.25)[middle], atol=1e-4)
    assert 0 < probability.min() < probability.max() < 1
    assert (np.diff(calibrate(np.linspace(0, 1, 100_001)[1:-1], 0.3, 2.0)) > 0).all()
    assert np.isfinite(calibrate(np.array([0.0, 1.0]), 5.0, 1.0)).all()


@pytest.mark.parametrize("count", [0, 1, 8192, 8193])
def test_a_rows_value_does_not_depend_on_its_neighbours(folder, count):
    X, one = rows(count), load_model(folder)
    probability = one.match(X)
    assert probability.shape == (count,)
    np.testing.assert_array_equal(one.match(np.asfortranarray(X)), probability)
    for i in {0, count // 2, count - 1} if count else ():
        np.testing.assert_allclose(one.match(X[i : i + 1])[0], probability[i], rtol=1e-6)


def test_rows_of_another_kind_are_refused(folder):
    match = load_model(folder).match
    refused(FeatureError, "float64", match, rows(5).astype(np.float64))
    refused(FeatureError, "list", match, rows(5).tolist())
    refused(FeatureError, rf"\({WIDTH},\)", match, rows(5)[0])
    refused(FeatureError, rf"\(N, {WIDTH}\)", match, rows(5, WIDTH - 1))
    for value in (np.nan, -np.inf):
        refused(FeatureError, f"{PLACED} of row 3", match, np.where(PLACE, np.float32(value), rows(5)))


def test_a_name_is_found_in_the_package_before_the_checkout(tmp_path, monkeypatch):
    package = tmp_path / "src" / "epiprior"
    package.mkdir(parents=True)
    monkeypatch.setattr(settings_file, "__file__", str(package / "settings_file.py"))
    (tmp_path / "models").mkdir()
    checkout = make_model(tmp_path / "models" / "default")
    assert find_model("default") == checkout
    model = load_model("default")
    assert (model.name, model.manifest["preset"]) == ("default", "default")
    assert model.two_keypoint.columns == DEFAULT.two_keypoint_columns
    assert model.match.columns == DEFAULT.match_columns
    (package / "_models").mkdir()
    shutil.copytree(checkout, package / "_models" / "default")
    assert find_model("default") == package / "_models" / "default"


def test_a_string_with_a_slash_is_a_folder_and_others_are_names(folder):
    assert load_model(str(folder)).name == "default"
    for unknown in (str(folder / "absent"), Path("default"), "no-such-model", ""):
        message = "no such folder" if "/" in str(unknown) or isinstance(unknown, Path) else "no model named"
        refused(ModelError, message, load_model, unknown)


# --- damage: the message names the file and what differs


@pytest.mark.parametrize("name", ["two_keypoint.onnx", "match.onnx", "README.md", "manifest.json"])
def test_a_changed_byte_and_a_missing_file_are_found(folder, name):
    if name != "manifest.json":
        content = bytearray((folder / name).read_bytes())
        content[len(content) // 2] ^= 1
        (folder / name).write_bytes(bytes(content))
        refused(ModelError, rf"{name}: sha256 is \w+, manifest.json says", load_model, folder)
    (folder / name).unlink()
    refused(ModelError, rf"^{re.escape(str(folder / name))}: cannot be read", load_model, folder)


@pytest.mark.parametrize("text", ["", "{", "\x00\xff", "[]", "{}", '"schema_version"', 100_000 * "["])
def test_a_manifest_that_is_none_is_refused(folder, text):
    (folder / "manifest.json").write_text(text, encoding="latin-1")
    refused(ModelError, r"manifest.json", load_model, folder)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"schema_version": 2}, "schema_version is 2"),
        ({"name": None}, "name is None"),
        ({"files": None}, "files / two_keypoint.onnx is None"),
        ({"match": None}, "match / features is None"),
        ({"match__features": "similarity"}, "expected list"),
        ({"match__features": ["a"] * WIDTH}, "expected different names"),
        ({"match__features": list(range(WIDTH))}, "expected different names"),
        ({"match__features": ["a", "b"]}, rf"match.onnx: takes {WIDTH} columns, manifest.json names 2: a, b"),
        ({"match__calibration__a": None}, "calibration / a is None"),
        ({"match__calibration__a": "1"}, "calibration / a is '1'"),
        ({"match__calibration__a": 0.0}, "a > 0"),
        ({"match__calibration__a": float("nan")}, "finite"),
        ({"match__calibration__b": float("inf")}, "finite"),
    ],
)
def test_a_manifest_that_says_something_else_is_refused(folder, entries, message):
    edit(folder, **entries)
    refused(ModelError, message, load_model, folder)


def test_a_graph_that_does_not_fit_is_refused(folder):
    """With its own hash in the manifest, so that only the content can be refused."""
    files = json.loads((folder / "manifest.json").read_text())["files"]
    other = logistic(DEFAULT.match_columns, {}, 0.0).replace(b"probability", b"probabilitx")
    for graph, message in ((b"not a graph", r"match.onnx: onnxruntime cannot load it"), (other, "probabilitx")):
        (folder / "match.onnx").write_bytes(graph)
        edit(folder, files=files | {"match.onnx": hashlib.sha256(graph).hexdigest()})
        refused(ModelError, message, load_model, folder)
