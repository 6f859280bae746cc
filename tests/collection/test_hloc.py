"""Files of hloc: its features in, its matches out, read as hloc reads them."""

from dataclasses import replace

import numpy as np
import pytest

from collections_fakes import MATCHES, in_this_process, small_images
from epiprior import FeatureError, OutputError, match_collection
from epiprior.collection.hloc import check_hloc_output, read_hloc_images, write_hloc_matches
from epiprior.collection.verify import judge_pairs
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph
from epiprior.io import read_hloc_features
from feature_files import hloc_parts, write_h5

h5py = pytest.importorskip("h5py")
NAMES = ("a.png", "sub/b.png", "sub/c.png")


@pytest.fixture
def feats(tmp_path):
    """Features of three images, with the roots that COLMAP and hloc take."""
    images = {}
    for name, path in zip(NAMES, small_images(tmp_path / "set", NAMES), strict=True):
        own = detect_features(load_photograph(path))
        roots = np.sqrt(np.sqrt(own.descriptors / own.descriptors.sum(axis=1, keepdims=True)))
        images[name] = hloc_parts(replace(own, descriptors=roots))
    return write_h5(tmp_path / "feats.h5", images)


def read_as_hloc_does(path, name0, name1):
    """As `get_matches` of hloc/utils/io.py: rows of matches, and their scores."""
    with h5py.File(path, "r") as file:
        group = file["/".join((name0.replace("/", "-"), name1.replace("/", "-")))]
        matches, scores = group["matches0"].__array__(), group["matching_scores0"].__array__()
    index = np.where(matches != -1)[0]
    return np.stack([index, matches[index]], -1), scores[index], matches, scores


@pytest.mark.parametrize("with_photographs", [True, False])
def test_matches_are_read_as_by_hloc(tmp_path, feats, monkeypatch, with_photographs):
    estimation = in_this_process(monkeypatch)
    (tmp_path / "pairs.txt").write_text("sub/b.png a.png\nsub/b.png sub/c.png\n")
    images = read_hloc_images(feats, tmp_path / "set" if with_photographs else None)
    found = match_collection(
        images, pairs=str(tmp_path / "pairs.txt"), given=lambda name: read_hloc_features(feats, name)
    )
    assert all((call["views"][0] is not None) == with_photographs for call in estimation.calls)
    assert write_hloc_matches(tmp_path / "matches.h5", judge_pairs(found, 0.5)) == 2
    for pair in found:
        matches, scores, whole, all_scores = read_as_hloc_does(tmp_path / "matches.h5", pair.image1, pair.image2)
        assert len(matches) == MATCHES
        assert sorted(map(tuple, matches)) == sorted(map(tuple, pair.matches))
        assert (scores == 1).all()
        assert (whole.dtype, all_scores.dtype) == (np.int16, np.float16)
        with h5py.File(feats, "r") as file:
            assert len(whole) == len(all_scores) == len(file[f"{pair.image1}/keypoints"])
    assert write_hloc_matches(tmp_path / "none.h5", judge_pairs(found, 1.1)) == 0
    assert not len(read_as_hloc_does(tmp_path / "none.h5", "a.png", "sub/b.png")[0])
    read = type(found).read
    monkeypatch.setattr(type(found), "read", lambda *pair: replace(read(*pair), geometry="WATERMARK"))
    assert write_hloc_matches(tmp_path / "marked.h5", judge_pairs(found, 0.5)) == 0
    assert not len(read_as_hloc_does(tmp_path / "marked.h5", "a.png", "sub/b.png")[0])


def test_files_that_cannot_be(tmp_path, feats):
    with pytest.raises(OutputError, match=r"feats\.h5: exists already"):
        check_hloc_output(feats)
    (tmp_path / "text.h5").write_text("no features")
    with pytest.raises(FeatureError, match=r"text\.h5: not an h5 file"):
        read_hloc_images(tmp_path / "text.h5", None)
    with h5py.File(feats, "a") as file:
        file.create_dataset("sub-b.png/keypoints", data=np.zeros((3, 2)))
    with pytest.raises(FeatureError, match="is called like another image"):
        read_hloc_images(feats, None)
