"""Rankers of others and learned matchers, run in an environment of their own."""

import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from calls import refused
from epiprior.errors import SettingsError
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior_lab.evaluation import learned, peers
from epiprior_lab.evaluation.inputs import read_peer_matches
from epiprior_lab.evaluation.peers import write_peer_matches
from pictures import save

ROOT = Path(__file__).parents[3]

# Stands in for torch and another OpenCV: matches every feature of image 1 with the one of the same number.
SCRIPT = """
import json, sys
from pathlib import Path
import numpy as np
folder = Path(sys.argv[1])
for pair_id, first, second, rankers in json.loads((folder / "pairs.json").read_text()):
    n = min(len(np.load(folder / f"{name}.npz")["xy"]) for name in (first, second))
    for k, ranker in enumerate(rankers):
        if ranker == "broken":
            sys.exit("it is broken")
        rows = np.column_stack([np.arange(n), np.arange(n)])[::-1][k:]
        np.savez(folder / f"{pair_id}.{ranker}.npz", rows=rows)
"""

# The same for learned matchers: as many matches as letters in its name, and a line in a log each time it runs.
LEARNED = """
import json, sys
from pathlib import Path
import numpy as np
folder = Path(sys.argv[1])
request = json.loads((folder / "request.json").read_text())
with (Path(__file__).parent / "log").open("a") as log:
    print(request["peer"], len(request["pairs"]), request["threads"], request["timed"], file=log)
n = len(request["peer"])
for k, pair in enumerate(request["pairs"]):
    x, index = np.column_stack([np.arange(n), np.arange(n)]) + 0.5, np.arange(n)
    np.savez(folder / f"{k}.npz", x1=x, x2=x + k, feature1=index, feature2=index, features=np.array([100, 90]))
if request["timed"]:
    (folder / "seconds.json").write_text(json.dumps([[2, 1]] * len(request["pairs"])))
if Path(request["pairs"][0][0]).name == "absent.png":
    sys.exit("no image")
"""


@pytest.fixture
def environment(tmp_path, monkeypatch):
    """A folder that looks like an environment, with this interpreter."""
    (tmp_path / "peers" / "bin").mkdir(parents=True)
    python = tmp_path / "peers" / "bin" / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')  # a link would leave the packages behind
    python.chmod(0o755)
    monkeypatch.setattr(peers, "ENVIRONMENT", tmp_path / "peers")
    for name, file in (("REQUIREMENTS", "versions.txt"), ("WEIGHTS", "weights.txt"), ("SCRIPT", "match.py")):
        monkeypatch.setattr(peers, name, tmp_path / file)
        (tmp_path / file).write_text("torch")
    return tmp_path / "peers"


def test_peers_run_in_an_environment_of_their_own(pairs, environment, tmp_path):
    (tmp_path / "match.py").write_text(SCRIPT)
    store = tmp_path / "store"
    write_peer_matches(pairs[:1], (), tmp_path / "none", store)
    assert list((tmp_path / "none").iterdir()) == []
    write_peer_matches(pairs[:1], ("a", "b"), tmp_path / "out", store)
    features = detect_features(load_photograph(pairs[0].image1))
    (first, _), (second, _) = (read_peer_matches(tmp_path / "out" / name / "relief-0.npz") for name in ("a", "b"))
    assert len(first) > 300
    assert len(second) == len(first) - 1
    np.testing.assert_array_equal(first.x1[::-1], features.xy[: len(first)])
    assert first.feature1.max() <= len(np.unique(features.xy, axis=0))
    refused(Exception, "it is broken", write_peer_matches, pairs[:1], ("broken",), tmp_path / "out", store)
    (environment / "bin" / "python").unlink()
    refused(SettingsError, "make peers", write_peer_matches, pairs[:1], ("a",), tmp_path / "out", store)


def test_learned_matchers_get_the_photographs(pairs, environment, tmp_path, monkeypatch):
    script, log, store = tmp_path / "learned.py", tmp_path / "log", tmp_path / "store"
    script.write_text(LEARNED)
    monkeypatch.setattr(learned, "SCRIPT", script)
    write_peer_matches(pairs, ("xfeat", "aliked"), tmp_path / "out", store)
    assert log.read_text().splitlines() == [f"{name} {len(pairs)} 1 False" for name in ("xfeat", "aliked")]
    for name in ("xfeat", "aliked"):
        for k, pair in enumerate(pairs):
            found, counts = read_peer_matches(tmp_path / "out" / name / f"{pair.pair_id}.npz")
            assert (len(found), counts) == (len(name), (100, 90))
            np.testing.assert_array_equal(found.x2 - found.x1, k)
    monkeypatch.setattr("epiprior_lab.compute.store._environment", lambda: b"of another installation")
    write_peer_matches(pairs, ("xfeat", "aliked"), tmp_path / "again", store)
    assert len(log.read_text().splitlines()) == 2  # a new library is no reason to match again; new weights are
    (tmp_path / "versions.txt").write_text("torch 2")
    write_peer_matches(pairs, ("xfeat",), tmp_path / "again", store)
    assert len(log.read_text().splitlines()) == 3


def test_learned_matchers_are_timed(pairs, environment, tmp_path):
    script, images = tmp_path / "learned.py", [(pair.image1, pair.image2) for pair in pairs]
    script.write_text(LEARNED)
    how = {"peer": "disk", "python": environment / "bin" / "python", "script": script, "threads": 2}
    found, seconds = learned.time_learned(images=images, **how)
    assert (seconds, [len(columns["x1"]) for columns in found]) == ([(2.0, 1.0)] * len(pairs), [4] * len(pairs))
    assert (tmp_path / "log").read_text() == f"disk {len(pairs)} 2 True\n"
    with pytest.raises(learned.LearnedError, match="disk: no image"):
        learned.time_learned(images=[(tmp_path / "absent.png", tmp_path / "absent.png")], **how)


class Tensor(np.ndarray):
    """What the script asks of torch's, by NumPy."""

    float = double = lambda self: self.astype(np.float64)

    def numpy(self):
        return self.view(np.ndarray)


def test_locations_come_back_in_pixels_of_the_image_as_given(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(from_numpy=lambda array: array.view(Tensor)))
    spec = importlib.util.spec_from_file_location("learned_script", ROOT / learned.SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert tuple(module.PEERS) == learned.LEARNED
    y, x = np.mgrid[:1600, :2500]
    found = []
    for number, (place, step) in enumerate((((1234.3, 801.7), 1), ((417.6, 303.2), 3))):
        blob = 255 * np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / 800)
        save(tmp_path / f"{number}.png", np.rint(blob[::step, ::step]).astype(np.uint8))
        image, factors = module.load(str(tmp_path / f"{number}.png"), (1, 32)[number])
        weight = np.asarray(image[0, 0])
        rows, columns = np.indices(weight.shape)
        centre = np.array([[(columns * weight).sum(), (rows * weight).sum()]]) / weight.sum()
        assert max(weight.shape) == (1024, 832)[number]
        found.append(({"keypoints": np.repeat(centre, 2, axis=0).view(Tensor)}, factors))
    score = np.array([0.2, 0.9])
    peer = SimpleNamespace(match=lambda *_: (np.array([[0, 1], [1, 0]]).view(Tensor), score.view(Tensor)))
    arrays = module.match(peer, *found)
    assert arrays["feature1"].tolist() == [1, 0]  # the best score first
    np.testing.assert_allclose(arrays["x1"], [[1234.3, 801.7]] * 2, atol=0.02)
    np.testing.assert_allclose(3 * arrays["x2"], [[417.6, 303.2]] * 2, atol=0.06)
    nothing = module.match(peer, ({"keypoints": np.empty((0, 2)).view(Tensor)}, 1.0), found[0])
    assert (nothing["x1"].shape, nothing["features"].tolist()) == ((0, 2), [0, 2])
