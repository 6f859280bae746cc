"""The uniform pair-set format: what is written is read back, and what is wrong is named with file and line."""

import cv2
import numpy as np
import pytest
from PIL import Image as PillowImage

from calls import refused
from epiprior.geometry import sampson_distance
from epiprior_lab import pairsets
from epiprior_lab.pairsets import PairFiles, check_pair_set, known_sets, read_pair_set, transfer, transfer_distance
from epiprior_lab.pairsets.cameras import Camera, CameraError, fundamental_from_cameras, reproject
from epiprior_lab.pairsets.files import DatasetError, encode_depth, image_size, npz_bytes, read_depth, write_matrix
from epiprior_lab.scenes.render import encode_jpeg
from worlds import CAMERAS, HEIGHT, WIDTH, camera_at, seen_by_both


def files(pair_id="p", **changes):
    jpeg = encode_jpeg(np.full((HEIGHT, WIDTH, 3), 90, np.uint8), 90)
    depth = np.full((HEIGHT, WIDTH), np.inf, np.float32)
    depth[50:] = np.linspace(2, 30, WIDTH, dtype=np.float32)
    values = {"pair_id": pair_id, "scene": f"scene of {pair_id}", "difficulty": "angle=3deg;overlap=0.5"}
    values |= {"cameras": CAMERAS, "jpegs": (jpeg, jpeg), "depths": 2 * (encode_depth(depth),)}
    return PairFiles(**(values | changes))


@pytest.fixture
def root(tmp_path):
    pairsets.write_pair_set(tmp_path / "family", [files("p"), files("q")])
    return tmp_path / "family"


def replace_in(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_what_is_written_is_read_back(root, tmp_path):
    pair_set = read_pair_set(root)
    assert (pair_set.name, [pair.pair_id for pair in pair_set.pairs]) == ("family", ["p", "q"])
    pair, wanted = pair_set.pairs[1], files("q")
    assert (pair.scene, pair.difficulty) == ("scene of q", "angle=3deg;overlap=0.5")
    for got, want in zip((pair.camera1, pair.camera2), wanted.cameras, strict=True):
        np.testing.assert_array_equal(np.column_stack([got.K, got.R, got.t]), np.column_stack([want.K, want.R, want.t]))
        assert (got.width, got.height) == (WIDTH, HEIGHT)
    depth1, _ = pair.depths()
    assert np.isinf(depth1[:50]).all()
    np.testing.assert_allclose(depth1[50], np.linspace(2, 30, WIDTH), rtol=1e-5)
    assert [path.is_file() for path in pair.files] == [True] * 4
    pairsets.write_pair_set(tmp_path / "again", [files("p"), files("q")])  # gives the same bytes
    for path in sorted(root.rglob("*.*")):
        assert path.read_bytes() == (tmp_path / "again" / path.relative_to(root)).read_bytes(), path
    (root / "depth" / "q_2.npz").unlink()
    pair = read_pair_set(root).pairs[1]
    assert pair.depths() is None
    refused(DatasetError, "no depth maps", pair.depth_views)


def test_control_points_are_found_in_the_set_or_in_another_folder_and_checked(root, tmp_path):
    x1, x2 = np.round(seen_by_both(2), 6)
    refused(DatasetError, r"'p' of .* has no control points", read_pair_set(root).pairs[0].control_points)
    pairsets.write_control_points(tmp_path / "points" / "p.csv", x1, x2)
    np.testing.assert_array_equal(read_pair_set(root, tmp_path / "points").pairs[0].control_points(), (x1, x2))
    refused(DatasetError, "nowhere", read_pair_set, root, tmp_path / "nowhere")
    pairsets.write_control_points(root / "control_points" / "p.csv", x1[:0], x2[:0])
    assert [x.shape for x in read_pair_set(root).pairs[0].control_points()] == [(0, 2), (0, 2)]
    points = root / "control_points" / "p.csv"
    x1, x2 = seen_by_both(20)
    pairsets.write_control_points(points, x1, x2)
    read_pair_set(root)
    pairsets.write_control_points(points, x2, x1)
    with pytest.raises(DatasetError, match=r"pairs\.csv, line 2: the F of the cameras .* its control points .*p\.csv"):
        read_pair_set(root)
    outside = "point 3, 500 lies outside image 2, 320 x 240"
    for row, message in (("1,2,three,4", "x2 = 'three'"), ("1,240,3,500", outside)):
        points.write_text(f"x1,y1,x2,y2\n1,2,3,4\n{row}\n")
        refused(DatasetError, rf"p\.csv, line 3: {message}", read_pair_set, root)


def test_depth_and_other_arrays_are_kept_and_the_same_each_time(tmp_path):
    depth = np.random.default_rng(0).uniform(0.5, 500, (40, 30)).astype(np.float32)
    depth[0, 0], depth[0, 1] = np.inf, 0.0
    (tmp_path / "d.npz").write_bytes(encode_depth(depth))
    got = read_depth(tmp_path / "d.npz")
    assert np.isinf(got[0, :2]).all()
    np.testing.assert_allclose(got[1:], depth[1:], rtol=1e-5)
    text = np.array(["a", "bc"])
    arrays = {"ints": np.arange(20_000), "text": text, "scalar": np.float32(3), "none": np.empty((0, 4))}
    content = npz_bytes(arrays)
    assert content == npz_bytes(arrays)
    assert len(content) < arrays["ints"].nbytes / 2
    (tmp_path / "a.npz").write_bytes(content)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as stored:
        assert list(stored) == list(arrays)
        for name, array in arrays.items():
            np.testing.assert_array_equal(stored[name], array)
            assert stored[name].dtype == array.dtype


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("pairs.csv", "pair_id,", "id,", r"pairs\.csv, line 1: no column 'pair_id'"),
        ("pairs.csv", "\nq,", "\np,", r"pairs\.csv, line 3: pair_id 'p'"),
        ("pairs.csv", "\nq,", "\na/q,", r"pairs\.csv, line 3: pair_id 'a/q' is no file name"),
        ("pairs.csv", "q_2.jpg", "gone.jpg", r"pairs\.csv, line 3: no image .*gone\.jpg"),
        ("pairs.csv", ",cameras,", ",guesses,", r"pairs\.csv, line 2: gt = 'guesses'"),
        ("pairs.csv", ",cameras,", ",control_points,", r"pairs\.csv, line 2: no control points .*p\.csv"),
        ("pairs.csv", ",scene of p,", ",scene,of p,", r"pairs\.csv, line 2: 7 values for 6 columns"),
        ("cameras.csv", "q_1.jpg,320", "q_1.jpg,wide", r"cameras\.csv, line 4: width = 'wide'"),
        ("cameras.csv", "q_1.jpg,320", "q_1.jpg,-320", r"cameras\.csv, line 4: image size -320"),
        ("cameras.csv", "q_1.jpg", "p_1.jpg", r"cameras\.csv, line 4: image 'images/p_1\.jpg' is there twice"),
        ("cameras.csv", "q_1.jpg", "r_1.jpg", r"pairs\.csv, line 3: .*no camera of 'images/q_1\.jpg'"),
        ("cameras.csv", ",300.0,", ",0,", r"cameras\.csv, line 2: focal lengths"),
        ("cameras.csv", ",300.0,", ",nan,", r"cameras\.csv, line 2: fx = 'nan'"),
    ],
)
def test_damage_is_named_with_file_and_line(root, file, old, new, message):
    replace_in(root / file, old, new)
    refused(DatasetError, message, read_pair_set, root)


def test_damage_in_depths_and_images_is_named_too(root):
    done = []
    assert check_pair_set(root, on_pair=lambda: done.append(1)).name == "family"
    assert len(done) == 2
    (root / "depth" / "p_1.npz").write_bytes(b"no archive")
    (root / "depth" / "q_1.npz").write_bytes(encode_depth(np.ones((3, 4), np.float32)))
    first, second = read_pair_set(root).pairs
    damaged, small = r"p_1\.npz: cannot be read", r"q_1\.npz: depth has shape \(3, 4\)"
    for look, message in ((first.depths, damaged), (second.depths, small), (lambda: check_pair_set(root), damaged)):
        refused(DatasetError, message, look)
    small = encode_jpeg(np.zeros((HEIGHT, 100, 3), np.uint8), 90)
    wrong_size = r"pairs\.csv, line 3: .*q_2\.jpg is 100 x 240, .* 320 x 240"
    for content, message in ((small, wrong_size), (b"no image", r"q_2\.jpg: is no image")):
        (root / "images" / "q_2.jpg").write_bytes(content)
        refused(DatasetError, message, read_pair_set, root)


@pytest.mark.parametrize(("kind", "truth"), [("homography", "plane"), ("fundamental", "epipolar")])
def test_a_matrix_as_ground_truth(root, kind, truth):
    replace_in(root / "pairs.csv", ",cameras,", f",{kind},")
    refused(DatasetError, rf"pairs\.csv, line 2: no {kind} .*p\.txt", read_pair_set, root)
    path = root / kind / "p.txt"
    path.parent.mkdir()
    path.write_text("0 0 0\n0 0 -1\n0 0 1\n")
    refused(DatasetError, r"p\.txt: the matrix (is singular|has a rank below 2)", read_pair_set, root)
    cameras = camera_at(-1.0), camera_at(1.5)
    (x1, x2), matrix = seen_by_both(20, cameras=cameras), fundamental_from_cameras(*cameras)
    if kind == "homography":
        matrix = np.array([[0.9, 0.1, 20.0], [-0.1, 1.1, 3.0], [1e-4, 0, 1.0]])
        x2 = transfer(matrix, x1)
    write_matrix(path, -5 * matrix)
    pair, other = read_pair_set(root).pairs
    got = getattr(pair, kind)()
    np.testing.assert_allclose(got / got[2, 2], matrix / matrix[2, 2], atol=1e-12)
    assert (pair.camera1, other.homography(), pair.truth, other.truth) == (None, None, truth, "3D")
    assert path in pair.files
    assert pair.sizes() == ((WIDTH, HEIGHT), (WIDTH, HEIGHT))
    # Control points must fit it.
    pairsets.write_control_points(root / "control_points" / "p.csv", x1, x2)
    read_pair_set(root)
    pairsets.write_control_points(root / "control_points" / "p.csv", x1, x2 + [0.0, 8.0])
    refused(DatasetError, rf"pairs\.csv, line 2: the ({kind}|F) .*p\.txt of pair 'p' .*p\.csv", read_pair_set, root)


def test_transfer_distance_counts_the_larger_side_and_reprojection_goes_there_and_back():
    H = np.diag([2.0, 2.0, 1.0])
    x1 = np.array([[10.0, 0.0], [10.0, 0.0]])
    np.testing.assert_allclose(transfer_distance(H, x1, np.array([[20.0, 0.0], [22.0, 0.0]])), [0.0, 2.0])
    np.testing.assert_allclose(transfer_distance(np.linalg.inv(H), np.array([[22.0, 0.0]]), x1[:1]), [2.0])
    assert np.isinf(transfer_distance(np.array([[1.0, 0, 0], [0, 1, 0], [-0.1, 0, 1]]), x1[:1], x1[:1])).all()
    cameras = camera_at(-2.0), camera_at(2.0, roll_deg=30)
    rng = np.random.default_rng(0)
    x1, depth1 = rng.uniform(0, 200, (50, 2)), rng.uniform(4, 20, 50)
    x2, depth2 = reproject(*cameras, x1, depth1)
    back, depth = reproject(*cameras[::-1], x2, depth2)
    np.testing.assert_allclose(back, x1, atol=1e-9)
    np.testing.assert_allclose(depth, depth1)
    assert sampson_distance(fundamental_from_cameras(*cameras), x1, x2).max() < 1e-9
    assert fundamental_from_cameras(camera_at(1.0), camera_at(1.0, roll_deg=40)) is None  # one centre decides no F
    x2, depth2 = reproject(camera_at(0.0), camera_at(0.0, z=-3.0), np.array([[160.0, 120.0]]), np.array([5.0]))
    assert np.isnan(x2).all()  # behind the camera there is no pixel
    assert depth2[0] < 0


def test_turned_photographs_have_the_size_that_opencv_sees(tmp_path):
    exif = PillowImage.Exif()
    exif[0x0112] = 6
    for path in (tmp_path / "turned.jpg", tmp_path / "turned.png"):
        PillowImage.fromarray(np.zeros((20, 30, 3), np.uint8)).save(path, exif=exif)
        assert image_size(path) == cv2.imread(str(path)).shape[1::-1] == (20, 30)


def test_known_sets_say_whether_they_are_present(root):
    paper = known_sets(paper=True)
    assert [known.name for known in paper] == ["zubud1", "zubud2", "blogs", "usac", "urban", "open1", "open2"]
    assert [known.pairs for known in paper] == [137, 137, 20, 11, 108, 246, 224]
    assert known_sets()[: len(paper)] == paper
    assert not paper[0].present(root.parent)
    root.rename(root.parent / "zubud1")
    assert paper[0].present(root.parent)


def test_a_folder_that_is_no_pair_set_is_named(tmp_path):
    refused(DatasetError, r"pairs\.csv: cannot be read", read_pair_set, tmp_path)
    header = b"pair_id,image1,image2,gt,scene,difficulty\n"
    for content, message in ((header, "no pair"), (b"\xff\xfe\x00", "cannot be read")):
        (tmp_path / "pairs.csv").write_bytes(content)
        refused(DatasetError, message, read_pair_set, tmp_path)
    for pairs in ([], [files("p"), files("p")]):
        refused(DatasetError, "pair ids", pairsets.write_pair_set, tmp_path / "set", pairs)


def test_impossible_cameras_are_refused():
    good = {"K": np.diag([100.0, 100.0, 1.0]), "R": np.eye(3), "t": np.zeros(3), "width": 10, "height": 10}
    for R in (2 * np.eye(3), np.diag([1.0, 1.0, -1.0])):
        refused(CameraError, "not a rotation", Camera, **good | {"R": R})
    for t in (np.zeros(2), np.array([0, np.nan, 0])):
        refused(CameraError, "t has shape", Camera, **good | {"t": t})
    refused(CameraError, "image size", Camera, **good | {"height": 0})
