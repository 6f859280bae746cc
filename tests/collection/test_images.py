"""Which photographs a collection has: found, named and checked before any work."""

import logging

import numpy as np
import pytest

from collections_fakes import small_images
from epiprior import ImageError
from epiprior.collection.features import feature_key, make_features, read_features
from epiprior.collection.images import find_images
from epiprior.presets import FeatureSettings
from pictures import save, texture, turned_jpeg


def test_images_are_found_in_folders_and_named_from_the_deepest_that_holds_all(tmp_path, caplog):
    small_images(tmp_path / "set", ("_b.png", "sub/a b.png", ".c.png", ".hidden/c.png", "._b.png", "._a.png"))
    (tmp_path / "set" / "notes.txt").write_text("no image")
    with caplog.at_level(logging.WARNING, "epiprior"):
        found = find_images(tmp_path / "set")
    assert [image.name for image in found.images] == [".c.png", "_b.png", "sub/a b.png"]
    assert found.root == tmp_path / "set"
    (line,) = caplog.messages
    assert "._a.png: one of 2 files named ._*" in line
    files = small_images(tmp_path, ("x/y/b.png", "x/z/a.png"))
    assert [image.name for image in find_images(files).images] == ["y/b.png", "z/a.png"]


def test_the_same_bytes_count_once(tmp_path, caplog):
    (tmp_path / "d.png").write_bytes(small_images(tmp_path)[0].read_bytes())
    found = find_images(tmp_path)
    assert len(found.images) == 3
    assert found.left_out == (("d.png", "the same bytes as a.png"),)
    assert "left out d.png: the same bytes as a.png" in caplog.messages


def test_turned_images_are_taken_as_stored_and_it_is_said_once(tmp_path, caplog):
    save(tmp_path / "a.png", texture(64, 48, 1))
    for name in ("b.jpg", "c.jpg"):
        turned_jpeg(tmp_path / name)
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes() + name.encode())
    found = find_images(tmp_path)
    (line,) = caplog.messages
    assert line.startswith("2 images have an EXIF orientation, which is ignored as COLMAP does: b.jpg")
    (tmp_path / "b.npz").write_bytes(make_features(found.images[1], FeatureSettings()))
    assert read_features(tmp_path / "b.npz").features.image_size == (64, 48)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("missing", r"gone\.png: no such image file"),
        ("unreadable", r"bad\.png: not an image"),
        ("two unreadable", r"bad\.png: not an image.*worse\.png: not an image"),
        ("twice", r"a\.png: is given twice"),
        ("not UTF-8", "not UTF-8"),
        ("one", "1 images, at least two"),
        ("no folder of masks", "no such folder of masks"),
        ("no mask", r"b\.png: has no mask .*b\.png"),
        ("mask of another size", r"b\.png\.png: is 100 x 150, its image 200 x 150"),
    ],
)
def test_what_cannot_be_used_is_named(tmp_path, kind, words):
    files, masks = small_images(tmp_path / "set"), None
    if kind == "missing":
        files.append(tmp_path / "gone.png")
    elif "unreadable" in kind:
        for name in ("bad.png", "worse.png")[: 1 + ("two" in kind)]:
            files.append(tmp_path / name)
            files[-1].write_text("not a picture")
    elif kind == "twice":
        files.append(files[0].parent / ".." / "set" / files[0].name)
    elif kind == "not UTF-8":
        files.append(tmp_path / b"caf\xe9.png".decode(errors="surrogateescape"))
        files[-1].write_bytes(files[0].read_bytes())
    elif kind == "one":
        files = files[:1]
    else:
        masks = tmp_path / "masks"
        if kind != "no folder of masks":
            masks.mkdir()
            save(masks / "a.png", np.full((150, 200), 255, np.uint8))
        if kind == "mask of another size":
            save(masks / "b.png.png", np.full((150, 100), 255, np.uint8))
    with pytest.raises(ImageError, match=f"(?s){words}"):
        find_images(files, mask_path=masks)


def test_nothing_is_found_where_a_mask_is_black(tmp_path):
    small_images(tmp_path / "set")
    for name in "abc":
        mask = np.full((150, 200), 255, np.uint8)
        mask[:, 100:] = 0
        save(tmp_path / f"{name}.png", mask)
    masked, whole = find_images(tmp_path / "set", mask_path=tmp_path), find_images(tmp_path / "set")
    files = []
    for image in (masked.images[0], whole.images[0]):
        files.append(tmp_path / f"{len(files)}.npz")
        files[-1].write_bytes(make_features(image, FeatureSettings()))
    x, everywhere = (read_features(file).features.xy[:, 0] for file in files)
    assert len(x) > 30
    assert x.max() < 101 < everywhere.max()
    assert feature_key(masked.images[0], FeatureSettings()) != feature_key(whole.images[0], FeatureSettings())
