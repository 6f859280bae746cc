from dataclasses import replace

import cv2
import numpy as np

from calls import refused
from epiprior.errors import ImageError
from epiprior_lab.pairsets import DatasetError
from epiprior_lab.report.pictures import _caption, contact_sheet
from worlds import camera_pair


def pair_of(tmp_path, name, colour, shape=(90, 120)):
    paths = [tmp_path / f"{name}_{k}.png" for k in (1, 2)]
    for path in paths:
        cv2.imwrite(str(path), np.full((*shape, 3), colour, np.uint8))
    return camera_pair(paths[0], (None, None), pair_id=name, image2=paths[1], difficulty="angle=30.0deg;overlap=0.40")


def test_every_pair_is_on_the_sheet_and_none_or_unreadable_ones_are_errors(tmp_path):
    colours = [(0, 0, 255), (0, 200, 0), (200, 0, 0)]
    pairs = [pair_of(tmp_path, f"p{k}", colour) for k, colour in enumerate(colours)]
    sheets = {"open": pairs[:2], "rolled": [pair_of(tmp_path, "tall", colours[2], (200, 80))]}
    path = contact_sheet(sheets, tmp_path / "figures" / "sheet.png")
    image = cv2.imread(str(path)).reshape(-1, 3)
    for colour in colours:
        assert (image == colour).all(axis=1).sum() > 2000, colour
    assert contact_sheet(sheets, path).read_bytes() == path.read_bytes()
    refused(DatasetError, "no pairs", contact_sheet, {"open": []}, tmp_path / "sheet.png")
    pair = pair_of(tmp_path, "p", (9, 9, 9))
    pair.image2.write_text("no image")
    refused(ImageError, r"p_2\.png", contact_sheet, {"open": [pair]}, tmp_path / "sheet.png")
    for roll, shown in ((348, -12), (180, 180), (181, -179), (0, 0), (-7, -7)):  # at most half a turn
        assert _caption(replace(pair, difficulty=f"overlap=0.50;roll={roll}deg")) == f"overlap 0.50   roll {shown}°"
