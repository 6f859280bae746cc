"""`epiprior explain`: it names the rows that `epiprior match` writes; in words, as JSON and as a picture."""

import json

import cv2
import pytest

from command_line import one_line
from command_line import run_command as run
from epiprior.io import read_matches
from pictures import relief_pair, save
from tiny_model import make_model


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photographs")
    return [save(folder / f"{name}.png", picture) for name, picture in zip("ab", relief_pair(300, 220), strict=True)]


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return make_model(tmp_path_factory.mktemp("models") / "default")


def test_a_row_of_the_written_matches(pair, model, tmp_path, monkeypatch):
    monkeypatch.setattr("epiprior.ranking.models.find_model", lambda name: model)
    options = ("--max-features", 1000)
    assert run("match", *pair, "--out", tmp_path / "m.npz", *options).exit_code == 0
    (written,) = read_matches(tmp_path / "m.npz")
    result = run("explain", *pair, "--match", 7, "--json", "--out", tmp_path / "why.png", *options)
    assert result.exit_code == 0, result.stderr
    printed = json.loads(result.stdout)
    assert (printed["match"], printed["set"], printed["in_x"]) == (7, 0, True)
    assert printed["x1"] == written.x1[7].tolist()
    assert printed["probability"] == written.probability[7]
    assert printed["supporting_matrices"] == written.supporting_matrices[7]
    (judged,) = printed["rounds"]
    similarity = next(column for column in judged["columns"] if column["name"] == "similarity")
    assert similarity["value"] == pytest.approx(written.similarity[7])
    for partner in printed["two_keypoints"]:
        assert partner["x2"] == written.x2[partner["match"]].tolist()
    assert len(printed["best_matrix"]["F"]) == 3
    assert cv2.imread(str(tmp_path / "why.png")).shape[1] > 900

    words = run("explain", *pair, "--match", 7, *options).stdout
    for expected in ("match 7: (", "hold it: ", "rough F", "best rough F", "round 1; ", "p if least", "similarity "):
        assert expected in words
    beyond = run("--quiet", "explain", *pair, "--match", len(written), *options)
    assert (beyond.exit_code, beyond.stdout) == (2, "")
    assert f"there are {len(written)} matches" in one_line(beyond)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--mode", "standard"), "mode is 'standard', but only ranked matches"),
        (("--out", "why.gif"), "why.gif: unknown suffix"),
    ],
)
def test_what_cannot_be_explained_is_refused_before_any_work(options, words):
    result = run("explain", "nothing.jpg", "nothing.jpg", "--match", 0, *options)
    assert result.exit_code == 2
    assert words in one_line(result)


def test_the_mode_that_exists_only_to_be_refused_is_not_offered():
    result = run("explain", "--help")
    assert "--match" in result.stdout
    assert "--mode" not in result.stdout
