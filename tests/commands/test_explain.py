"""`epiprior explain`: it names the rows that `epiprior match` writes; in words, as JSON and as a picture."""

import json

import cv2
import pytest

from command_line import one_line, refused
from command_line import run_command as run
from pictures import relief_pair, save
from tables import read_table


def test_a_row_of_the_written_matches(model_folder, tmp_path, monkeypatch):
    pair = [save(tmp_path / f"{name}.png", picture) for name, picture in zip("ab", relief_pair(300, 220), strict=True)]
    monkeypatch.setattr("epiprior.ranking.models.find_model", lambda name: model_folder)
    options = ("--max-features", 1000)
    assert run("match", *pair, "--out", tmp_path / "m.npz", *options).exit_code == 0
    (written,) = read_table(tmp_path / "m.npz")
    result = run("explain", *pair, "--match", 7, "--json", "--out", tmp_path / "why.png", *options)
    assert result.exit_code == 0, result.stderr
    printed = json.loads(result.stdout)
    assert (printed["match"], printed["set"], printed["in_x"]) == (7, 0, True)
    assert (printed["x1"], printed["probability"]) == (written.x1[7].tolist(), written.probability[7])
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


def test_what_cannot_be_explained_is_refused_before_any_work():
    nothing = ("explain", "nothing.jpg", "nothing.jpg", "--match", 0)
    assert "why.gif: unknown suffix" in refused(*nothing, "--out", "why.gif")
