"""Image files as other people have them: read rightly, or refused by a message that names file, reason and remedy."""

import re
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

import epiprior
from epiprior import ImageError, estimate_fundamental
from epiprior.draw.pictures import draw_matches
from epiprior.features.detect import detect_features
from epiprior.features.images import load_photograph, read_image
from epiprior.matching.baselines import standard_matches
from pictures import texture

PICTURE = texture(240, 180)


def encode(path, pixels):
    path.write_bytes(cv2.imencode(path.suffix, pixels)[1].tobytes())
    return path


def png_chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@pytest.mark.parametrize("name", [b"caf\xe9 1 of 4.png", "Bild \u00fc.png".encode(), b"a,b\t;'c.png"])
def test_any_file_name_can_be_read(tmp_path, name):
    path = tmp_path / name.decode(errors="surrogateescape")
    try:
        encode(path, PICTURE)
    except OSError:
        pytest.skip("the file system takes no such name")
    np.testing.assert_array_equal(load_photograph(path).grey, PICTURE)
    assert draw_matches(path, str(path), standard_matches(path, path)).any()


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".webp", ".bmp"])
@pytest.mark.parametrize("colour", [False, True])
def test_eight_bits_are_as_opencv_reads_them(tmp_path, suffix, colour):
    pixels = np.dstack([PICTURE, PICTURE[::-1], PICTURE[:, ::-1]]) if colour else PICTURE
    path = encode(tmp_path / f"a{suffix}", pixels // 2 + 30)
    for flag in (cv2.IMREAD_GRAYSCALE, cv2.IMREAD_COLOR):
        np.testing.assert_array_equal(read_image(path, flag), cv2.imread(str(path), flag))


@pytest.mark.parametrize(("low", "high"), [(3, 18), (0, 4095), (1000, 65535)])
def test_16_bits_are_stretched_by_their_own_range(tmp_path, low, high):
    values = low + np.rint((high - low) * cv2.normalize(PICTURE, None, 0, 1, cv2.NORM_MINMAX, cv2.CV_64F))
    photograph = load_photograph(encode(tmp_path / "a.png", values.astype(np.uint16)))
    np.testing.assert_array_equal(photograph.grey, np.rint((values - low) * 255 / (high - low)))
    assert len(detect_features(photograph)) > 300


@pytest.mark.parametrize("damage", ["garbled", "cut"])
def test_a_damaged_picture_is_read_and_a_warning_names_it(tmp_path, caplog, capfd, damage):
    data = encode(tmp_path / "whole.jpg", PICTURE).read_bytes()
    middle = len(data) // 2
    rest = data[middle + 100 :] if damage == "garbled" else b""
    garbage = np.random.default_rng(1).integers(0, 255, 100, np.uint8).tobytes() if damage == "garbled" else b""
    path = tmp_path / f"{damage}.jpg"
    path.write_bytes(data[:middle] + garbage + rest)
    whole = load_photograph(tmp_path / "whole.jpg").grey
    for _ in range(2):
        np.testing.assert_array_equal(load_photograph(path).grey[:48], whole[:48])
    (record,) = caplog.records
    assert (record.levelname, record.name) == ("WARNING", "epiprior.features.images")
    assert f"{damage}.jpg: damaged or cut" in record.message
    assert capfd.readouterr().err.count("Corrupt JPEG") == 0


def test_a_size_limit_is_named_and_how_to_raise_it(tmp_path):
    header = struct.pack(">IIBBBBB", 40_000, 30_000, 8, 0, 0, 0, 0)
    path = tmp_path / "large.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", header) + png_chunk(b"IDAT", zlib.compress(b"")))
    with pytest.raises(ImageError, match=r"large\.png.* 1073741824 pixels.*OPENCV_IO_MAX_IMAGE_PIXELS"):
        load_photograph(path)


@pytest.mark.parametrize("form", ["array", ".png", ".webp"])
@pytest.mark.parametrize("size", [240, 120])
def test_transparent_pixels_have_no_features(tmp_path, form, size):
    alpha = np.zeros_like(PICTURE)
    alpha[:, 100:] = 128
    pixels = np.dstack([PICTURE] * 3 + [alpha])
    image = pixels if form == "array" else encode(tmp_path / f"a{form}", pixels)
    photograph = load_photograph(image, size)
    features = detect_features(photograph)
    assert len(features) > 50
    assert features.xy[:, 0].min() > 99.0
    hidden = photograph.grey[:, : 100 * size // 240 - 1]
    assert hidden.min() == hidden.max()
    assert draw_matches(image, image, standard_matches(image, image)).any()


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_alpha_channel_is_turned_with_the_image(tmp_path, orientation):
    data = encode(tmp_path / "a.png", np.dstack([PICTURE] * 3 + [np.where(PICTURE > 128, 255, 0)])).read_bytes()
    exif = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0" + bytes([orientation]) + b"\0\0\0\0\0\0"
    path = tmp_path / "turned.png"
    path.write_bytes(data[:33] + png_chunk(b"eXIf", exif) + data[33:])
    photograph = load_photograph(path)
    turned = read_image(path, cv2.IMREAD_GRAYSCALE)
    assert turned.shape == ((180, 240) if orientation < 5 else (240, 180))
    np.testing.assert_array_equal(photograph.visible, turned > 128)


def test_too_few_matches_name_the_image_and_what_to_set(tmp_path):
    blank = encode(tmp_path / "blank.png", np.full((180, 240), 7, np.uint8))
    strip = encode(tmp_path / "strip.png", np.tile(texture(480, 30), (1, 8)))
    whole = encode(tmp_path / "whole.png", PICTURE)
    found = estimate_fundamental(whole, blank, mode="standard")
    assert f"{blank}: 0 features (darkest 7, brightest 7; worked at 240 x 180): the image is blank" in found.message
    assert "whole.png" not in found.message
    found = estimate_fundamental(strip, PICTURE[:4, :4], mode="standard")
    assert f"{strip}: 0 features (darkest " in found.message
    assert "worked at 1024 x 8): set --max-image-size higher, the image is 3840 x 30" in found.message
    assert "; image 2: 0 features" in found.message


def test_the_library_reads_and_writes_images_in_one_way_only():
    """OpenCV's own readers of files end with a crash where a name is not UTF-8."""
    folder = Path(epiprior.__file__).parent
    assert not [path for path in folder.rglob("*.py") if re.search(r"cv2\.im(read|write)\(", path.read_text("utf-8"))]
