"""Importers of published pairs: small samples in the original formats, made here."""

import dataclasses
import os

import cv2
import numpy as np
import pytest
import scipy.io
from typer.testing import CliRunner

from calls import refused
from epiprior.errors import EpipriorError, ImageError, OutputError
from epiprior.geometry import normalise_fundamental, sampson_distance
from epiprior_lab.cli import app
from epiprior_lab.labels.ground_truth import label_matches, reference_fundamental
from epiprior_lab.pairsets import DatasetError, fundamental_from_cameras, known_sets, read_pair_set, transfer
from epiprior_lab.pairsets.changed import shrinking
from epiprior_lab.pairsets.importers.match_files import find_match_files
from epiprior_lab.pairsets.importers.output import FoundPair, Photograph, write_found
from epiprior_lab.pairsets.importers.pair_list import find_pairs, find_usac
from epiprior_lab.pairsets.importers.sequences import find_sequences
from epiprior_lab.pairsets.importers.sources import read_rows
from pictures import save, texture
from worlds import CAMERAS, HEIGHT, WIDTH
from worlds import seen_by_both as matches

H = np.array([[0.9, 0.05, 12.0], [-0.04, 1.02, 5.0], [1e-4, -5e-5, 1.0]])


def picture(path, seed=0, width=WIDTH, height=HEIGHT):
    path.parent.mkdir(parents=True, exist_ok=True)
    return save(path, np.dstack([texture(width, height, seed)] * 3))


def homogeneous(x1, x2):
    ones = np.ones(len(x1))
    return np.vstack([x1.T, ones, x2.T, ones])


def lines(rows):
    return "".join(" ".join(f"{value:.6f}" for value in row) + "\n" for row in rows)


def assert_points(pair, x1, x2, tolerance=1e-5):
    got1, got2 = pair.control_points()
    np.testing.assert_allclose(got1, x1, atol=tolerance)
    np.testing.assert_allclose(got2, x2, atol=tolerance)


def written(out, found, **options):
    """Return the pairs of a new set, read back."""
    write_found(out, found, **options)
    return read_pair_set(out).pairs


def pair_of_pictures(folder, name):
    for side, letter in enumerate("AB"):
        picture(folder / f"{name}{letter}.png", side)
    return folder


@pytest.fixture
def kusvod2(tmp_path):
    folder = pair_of_pictures(tmp_path / "kusvod2", "shout")
    scipy.io.savemat(folder / "shout_vpts.mat", {"validation": {"pts": homogeneous(*matches()), "note": "x"}})
    return folder


def test_kusvod2_and_its_damage(kusvod2, tmp_path):
    (pair,) = write_found(tmp_path / "set", find_match_files("kusvod2", kusvod2)).pairs
    assert [pair.pair_id, pair.scene, pair.difficulty, pair.truth] == 2 * ["shout"] + ["30 manual points", "epipolar"]
    assert_points(read_pair_set(tmp_path / "set").pairs[0], *matches())
    assert (tmp_path / "set/images/shoutA.png").read_bytes() == (kusvod2 / "shoutA.png").read_bytes()
    (from_one,) = find_match_files("kusvod2", kusvod2, origin=1)
    np.testing.assert_allclose(from_one.points, np.array(matches()) - 1)
    path = kusvod2 / "shout_vpts.mat"
    (kusvod2 / "shoutB.png").unlink()
    cut, four_rows = path.read_bytes()[:200], {"validation": {"pts": np.ones((4, 9))}}
    for damage, message in (
        (lambda: None, "no image .*shoutB"),
        (lambda: path.write_bytes(cut), "cannot be read as a MATLAB file"),
        (lambda: scipy.io.savemat(path, four_rows), r"validation\.pts has shape \(4, 9\)"),
        (lambda: scipy.io.savemat(path, {"other": 1}), r"holds no validation\.pts"),
    ):
        damage()
        refused(DatasetError, rf"shout_vpts\.mat: {message}", find_match_files, "kusvod2", kusvod2)


def labelled():
    """Return right matches with labels 1 and 2 among wrong ones with label 0."""
    x1, x2 = matches(40)
    labels = np.tile([1, 0, 2, 2], 10)
    x2 = np.where(labels[:, None] == 0, x2[::-1], x2)
    return x1, x2, labels


def test_adelaidermf_from_mat_and_labelled_text_and_of_one_plane(tmp_path):
    x1, x2, labels = labelled()
    red = np.zeros((HEIGHT, WIDTH, 3), np.uint8) + np.array([250, 0, 0], np.uint8)  # as MATLAB orders colours
    content = {"img1": red, "img2": red, "data": homogeneous(x1, x2), "score": np.ones((1, 40)), "label": labels}
    scipy.io.savemat(tmp_path / "hall.mat", content)
    (pair,) = write_found(tmp_path / "set", find_match_files("adelaidermf", tmp_path)).pairs
    assert (pair.pair_id, pair.difficulty) == ("hall", "30 labelled matches, 2 planes")
    (pair,) = read_pair_set(tmp_path / "set").pairs
    assert_points(pair, x1[labels > 0], x2[labels > 0])
    blue, _, red = cv2.imread(str(pair.image1))[5, 5]
    assert blue < 50 < 200 < red
    folder = pair_of_pictures(tmp_path / "text", "hall")
    (folder / "hall_pts.txt").write_text(lines(np.vstack([homogeneous(x1, x2), labels]).T))
    (pair,) = written(tmp_path / "same", find_match_files("adelaidermf", folder))
    assert_points(pair, x1[labels > 0], x2[labels > 0])
    assert sampson_distance(fundamental_from_cameras(*CAMERAS), *pair.control_points()).max() < 1e-4
    x1, _ = matches(30)
    folder = pair_of_pictures(tmp_path / "one plane", "flat")
    (folder / "flat_pts.txt").write_text(lines(np.vstack([homogeneous(x1, transfer(H, x1)), np.ones(30)]).T))
    (pair,) = find_match_files("adelaidermf", folder)
    assert pair.difficulty == "30 labelled matches, 1 plane; all on one plane: they decide no F"


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ("1 2 1 3 4 1 1\n1 2 1 3 four 1 1\n", r"hall_pts\.txt, line 2: 'four' is not a finite number"),
        ("1 2 1 3 4 1\n", r"hall_pts\.txt, line 1: 6 numbers, expected 7"),
        ("1 2 1 3 4 1 0\n", r"hall_pts\.txt: no match is labelled as right"),
        ({"label": np.ones(7)}, r"hall\.mat: 7 labels for 40 matches"),
        ({"data": np.full((6, 40), np.nan)}, r"hall\.mat: data holds a value that is not finite"),
        ({"img2": np.zeros((4, 5))}, r"hall\.mat: img2 is no 8-bit image"),
        ({"img1": None}, r"hall\.mat: holds no img1"),
    ],
    ids=range(7),
)
def test_damage_of_adelaidermf_is_named(tmp_path, damage, message):
    if isinstance(damage, str):
        pair_of_pictures(tmp_path, "hall")
        (tmp_path / "hall_pts.txt").write_text(damage)
    else:
        x1, x2, labels = labelled()
        grey = np.zeros((HEIGHT, WIDTH), np.uint8)
        content = {"img1": grey, "img2": grey, "data": homogeneous(x1, x2), "label": labels} | damage
        scipy.io.savemat(tmp_path / "hall.mat", {name: value for name, value in content.items() if value is not None})
    refused(DatasetError, message, find_match_files, "adelaidermf", tmp_path)


@pytest.mark.parametrize("names", [("oxford", "img{}.ppm", "H1to{}p"), ("hpatches", "{}.ppm", "H_1_{}")])
def test_sequences_of_a_plane(names, tmp_path):
    name, stem, file = names
    scene = tmp_path / "all/v_graf"
    for number in (1, 2, 3):
        picture(scene / stem.format(number), number)
    for number in (2, 3):
        (scene / file.format(number)).write_text(lines(H * number))
    pairs = written(tmp_path / "set", find_sequences(name, tmp_path / "all"))
    assert [pair.pair_id for pair in pairs] == ["v_graf_1_2", "v_graf_1_3"]
    assert {(pair.scene, pair.difficulty) for pair in pairs} == {("v_graf", "viewpoint")}
    assert len(list((tmp_path / "set/images").iterdir())) == 3
    pair = pairs[0]
    assert pair.truth == "plane"
    np.testing.assert_allclose(pair.homography() * 2 / pair.homography()[2, 2], H * 2, rtol=1e-5, atol=1e-5)
    x1, x2 = pair.control_points()
    assert len(x1) > 50
    sigma = np.full(len(x1), 2.0)
    assert label_matches(pair, x1, x2, sigma, sigma).all()
    assert not label_matches(pair, x1, x2 + [4.0, 0.0], sigma, sigma).any()
    refused(DatasetError, "decide no fundamental", reference_fundamental, pair)


def test_damage_of_homographies_is_named(tmp_path):
    for number in (1, 2):
        picture(tmp_path / f"img{number}.ppm", number)
    for content, message in (
        ("1 0 0\n0 1\n0 0 1\n", r"H1to2p, line 2: 2 numbers, expected 3"),
        ("1 0 0\n0 1 0\n", r"H1to2p: 2 rows of a matrix, expected 3"),
        ("1 0 0\n1 0 0\n0 0 1\n", r"H1to2p: the matrix is singular"),
        ("1 0 5000\n0 1 0\n0 0 1\n", r"takes no point of .*img1\.ppm into .*img2\.ppm"),
    ):
        (tmp_path / "H1to2p").write_text(content)
        refused(DatasetError, message, lambda: write_found(tmp_path / "set", find_sequences("oxford", tmp_path)))
    (tmp_path / "img2.ppm").unlink()
    for name, message in (("oxford", r"H1to2p: no image .*img2"), ("hpatches", "no homography with a name")):
        refused(DatasetError, message, find_sequences, name, tmp_path)


def test_usac_needs_points_by_hand_and_its_damage_is_named(tmp_path):
    usac = tmp_path / "fundmatrix"
    for name in ("im1.jpg", "im2.jpg"):
        picture(usac / "test1" / name)
    x1, x2 = matches(80)
    x2[60:] = x2[60:][::-1]
    (usac / "test1" / "orig_pts.txt").write_text("80\n" + lines(np.hstack([x1, x2])))
    refused(DatasetError, r"no ground truth.*epiprior-lab label .*im1\.jpg .*im2\.jpg --out POINTS", find_usac, usac)
    x1, x2 = matches(16, seed=1)
    (tmp_path / "points").mkdir()
    (tmp_path / "points/test1.csv").write_text("x1,y1,x2,y2\n" + lines(np.hstack([x1, x2])).replace(" ", ","))
    (pair,) = written(tmp_path / "set", find_usac(usac, points=tmp_path / "points"))
    assert pair.difficulty == "points by hand; 80 matches"
    assert_points(pair, x1, x2)
    path = usac / "test1/orig_pts.txt"
    path.write_text(path.read_text().replace("80\n", "81\n", 1))
    refused(DatasetError, r"orig_pts\.txt: line 1 announces 81 rows, there are 80", find_usac, usac)
    (usac / "test1/im2.jpg").unlink()
    refused(DatasetError, r"orig_pts\.txt: no image .*im2\.jpg", find_usac, usac)


FIRST, SECOND, THIRD = (f"object0041.view0{number}.png" for number in (1, 2, 3))


@pytest.fixture
def listed(tmp_path):
    for number, name in enumerate((FIRST, SECOND, THIRD)):
        picture(tmp_path / "list" / name, number)
    x1, x2 = matches(12)
    both = "% x1 y1 x2 y2\n" + lines(np.hstack([x1, x2])).replace(" ", "\t")
    rows = f"image1,image2,points,points2\n{FIRST},{SECOND},a.txt,\n{FIRST},{THIRD},left.txt,right.txt\n"
    for name, text in (("a.txt", both), ("left.txt", lines(x1)), ("right.txt", lines(x2)), ("pairs.csv", rows)):
        (tmp_path / "list" / name).write_text(text)
    return tmp_path / "list"


def test_lists_of_pairs_and_known_sets_that_have_their_number_of_pairs(listed, tmp_path):
    pairs = written(tmp_path / "set", find_pairs(listed / "pairs.csv"))
    assert [pair.pair_id for pair in pairs] == [f"object0041.view01_object0041.view0{number}" for number in (2, 3)]
    for pair in pairs:
        assert_points(pair, *matches(12))
    refused(DatasetError, r"pairs\.csv: 2 pairs, ZuBuD1 has 137", find_pairs, listed / "pairs.csv", known="zubud1")
    refused(DatasetError, "unknown set 'zubud'; .* zubud1", find_pairs, listed / "pairs.csv", known="zubud")
    known = {known.name: known for known in known_sets()}
    assert known["zubud2"].scene("object0041.view01") == "object0041"
    assert known["blogs"].scene("corridor1") == "corridor"


@pytest.mark.parametrize("kind", ["homography", "fundamental"])
def test_lists_with_matrices_that_count_from_one(listed, tmp_path, kind):
    x1, x2 = matches(12)
    given = H if kind == "homography" else fundamental_from_cameras(*CAMERAS)
    shift = np.array([[1.0, 0, 1], [0, 1, 1], [0, 0, 1]])
    back = np.linalg.inv(shift)
    from_one = shift @ given @ back if kind == "homography" else back.T @ given @ back
    # A matrix of a large scale, all digits
    np.savetxt(listed / "m.txt", 1e3 * from_one)
    (listed / "m.csv").write_text(f"image1,image2,{kind}\n{FIRST},{SECOND},m.txt\n")
    (pair,) = written(tmp_path / "set", find_pairs(listed / "m.csv", origin=1.0))
    if kind == "homography":
        np.testing.assert_allclose(transfer(pair.homography(), x1), transfer(H, x1), atol=1e-6)
    else:
        assert pair.truth == "epipolar"
        assert sampson_distance(reference_fundamental(pair), x1, x2).max() < 1e-6


def test_damage_of_lists_is_named_and_points_that_fit_no_given_matrix_when_the_set_is_written(listed, tmp_path):
    for row, message in (
        (f"gone.png,{SECOND},a.txt", r"t\.csv, line 2: no image .*gone\.png"),
        (f"{FIRST},{SECOND},", r"t\.csv, line 2: none of points, homography, fundamental"),
        (f"{FIRST},{SECOND},gone.txt", r"gone\.txt: cannot be read"),
        (f"{FIRST},{SECOND}", r"t\.csv, line 2: 2 values for 3 columns"),
    ):
        (listed / "t.csv").write_text(f"image1,image2,points\n{row}\n")
        refused(DatasetError, message, find_pairs, listed / "t.csv")
    np.savetxt(listed / "F.txt", fundamental_from_cameras(*CAMERAS[::-1]))  # images in the other order
    (listed / "t.csv").write_text(f"image1,image2,points,fundamental\n{FIRST},{SECOND},a.txt,F.txt\n")
    message = r"pairs\.csv, line 2: the F .*view02\.txt of pair .* does not fit .*view02\.csv"
    refused(DatasetError, message, write_found, tmp_path / "set", find_pairs(listed / "t.csv"))
    assert not (tmp_path / "set").exists()


def test_rows_of_text_in_several_spellings(tmp_path):
    path = tmp_path / "t.txt"
    for content in ("x1 y1 x2 y2\n1, 2, 3, 4\n", "# a\n1;2;3;4\n\n", "1\n1\t2\t3\t4\n", "\ufeff1 2 3 4"):
        path.write_text(content)
        np.testing.assert_array_equal(read_rows(path, (4,)), [[1, 2, 3, 4]])
    path.write_text("")
    assert read_rows(path, (4, 6)).shape == (0, 4)
    two_widths = ("1 2 3 4\n1 2 3 4 5 6\n", "line 2: 6 numbers, expected 4")
    for content, message in (two_widths, ("1 2 nan 4\n", "line 1: 'nan'")):
        path.write_text(content)
        refused(DatasetError, message, read_rows, path, (4, 6))


def test_smaller_images_take_everything_with_them(tmp_path):
    corners = transfer(shrinking((640, 480), (320, 120)), np.array([[-0.5, -0.5], [639.5, 479.5]]))
    np.testing.assert_allclose(corners, [[-0.5, -0.5], [319.5, 119.5]])
    images = {"image1": picture(tmp_path / "a.png", 1, 640, 480), "image2": picture(tmp_path / "b.png", 2)}
    (x1, x2), F = matches(), fundamental_from_cameras(*CAMERAS)
    grow = shrinking((320, 240), (640, 480))
    points, matrix = (transfer(grow, x1), x2), F @ np.linalg.inv(grow)
    photographs = {name: Photograph(name=path.stem, path=path) for name, path in images.items()}
    pair = FoundPair(pair_id="p", scene="s", **photographs, points=points, fundamental=matrix)
    (got,) = written(tmp_path / "set", [pair], max_side=320)
    assert got.sizes() == ((320, 240), (320, 240))
    assert_points(got, x1, x2)
    np.testing.assert_allclose(got.fundamental(), normalise_fundamental(F), atol=1e-9)


def test_a_pair_set_is_not_overwritten_and_all_is_checked_before_anything_is_written(kusvod2, tmp_path):
    (pair,) = find_match_files("kusvod2", kusvod2)
    refused(OutputError, "exists already", write_found, kusvod2, [pair])
    refused(DatasetError, "no pair was found", write_found, tmp_path / "none", [])
    (tmp_path / "broken.png").write_bytes(pair.image1.path.read_bytes()[:60])
    broken = Photograph(name="broken", path=tmp_path / "broken.png")
    same = {"pair_id": "other", "image1": Photograph(name="shoutA", path=pair.image2.path)}
    for change, kind, message in (
        (same, DatasetError, r"shoutA\.png and .*shoutB\.png would both become images/shoutA"),
        ({"image2": broken}, ImageError, r"broken\.png: not an image"),
        ({"pair_id": "a/b"}, DatasetError, "pair 'a/b'"),
        ({"pair_id": 200 * "é"}, DatasetError, "250 bytes"),
    ):
        refused(kind, message, write_found, tmp_path / "new", [pair, dataclasses.replace(pair, **change)])
    assert not list(tmp_path.glob("n*"))


def test_names_of_any_bytes_are_kept_and_files_of_macos_are_skipped(kusvod2, tmp_path):
    for ending in ("A.png", "B.png", "_vpts.mat"):
        (kusvod2 / f"shout{ending}").rename(kusvod2 / os.fsdecode(b"caf\xe9, 1 of 4" + ending.encode()))
        (kusvod2 / f"._shout{ending}").write_bytes(b"attributes")
    (pair,) = written(tmp_path / "set", find_match_files("kusvod2", kusvod2))
    assert (pair.pair_id, pair.image1.name) == ("café, 1 of 4", "café, 1 of 4A.png")
    assert_points(pair, *matches())


def test_commands(kusvod2, tmp_path):
    def run(*arguments):
        return CliRunner().invoke(app, [*map(str, arguments)])

    own = tmp_path / "real" / "kusvod2"
    done = run("import", "kusvod2", kusvod2, "--out", own)
    assert done.exit_code == 0, done.output
    assert "1 pair of 1 scene" in done.stdout
    assert "1 pair of 1 scene, truth: epipolar" in run("check-set", own).stdout
    assert run("sets", own.parent).stdout.count("not present") == len(known_sets()) - 1
    assert sum(known.pairs for known in known_sets(paper=True)) == 883
    image = own / "images" / "shoutB.png"
    image.write_bytes(image.read_bytes()[:200])
    read_pair_set(own)  # unlike `check-set`, this reads no image
    importers = ("colmap", "strecha", "adelaidermf", "oxford", "hpatches", "usac", "pairs", "photos")
    calls = [(("import", name, tmp_path / "nowhere", "--out", tmp_path / "x"), "nowhere") for name in importers]
    for arguments, culprit in (*calls, (("check-set", own), "shoutB.png")):
        done = run(*arguments)
        assert isinstance(done.exception, EpipriorError), arguments
        assert culprit in str(done.exception)
