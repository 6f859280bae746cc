"""Rendered scenes: depth and image agree with the cameras, seeds decide everything, families keep their bounds."""

import dataclasses

import cv2
import numpy as np
import pytest

from epiprior.errors import SettingsError
from epiprior.geometry import sampson_distance
from epiprior_lab import pairsets
from epiprior_lab.compute.seeds import child_seed
from epiprior_lab.compute.tasks import Task, map_tasks
from epiprior_lab.labels.ground_truth import TRUTH, control_points_from_depth
from epiprior_lab.labels.solvable import right_among_putative
from epiprior_lab.pairsets import Camera, encode_depth, fundamental_from_cameras, read_pair_set, reproject
from epiprior_lab.scenes import pairs, textures
from epiprior_lab.scenes.pairs import SceneError, look_at, render_pair
from epiprior_lab.scenes.render import Light, render_depth, render_image
from epiprior_lab.scenes.settings import FAMILIES
from epiprior_lab.scenes.world import FIRST_VIEW, SECOND_VIEW, Frame, WorldBuilder, upright
from epiprior_lab.stages.render import render, render_solvable
from worlds import HEIGHT, OVERCAST_FROM_ASIDE, WIDTH, camera_at, room

SMALL = {"width": 256, "height": 192}


def plain_camera(**changes):
    K = np.array([[200.0, 0.0, 99.5], [0.0, 200.0, 74.5], [0.0, 0.0, 1.0]])
    return Camera(**({"K": K, "R": np.eye(3), "t": np.zeros(3), "width": 200, "height": 150} | changes))


def builder_of(*colours):
    builder = WorldBuilder(surroundings=np.zeros((8, 16, 3), np.uint8))
    return builder, [builder.texture(np.full((16, 16, 3), colour, np.uint8)) for colour in colours]


def plane(builder, texture, z, side, **options):
    """Put a square of that side before the camera."""
    builder.face((-side / 2, -side / 2, z), (side, 0, 0), (0, side, 0), texture, **options)


def picture(world, camera, light=OVERCAST_FROM_ASIDE):
    return render_image(world, camera, light)


def test_depth_of_a_slanted_plane_is_the_analytic_one_and_nearer_faces_hide_farther_ones():
    builder, (white,) = builder_of(255)
    normal, offset = np.array([0.3, -0.2, 1.0]), 7.0  # normal . X = offset
    across = np.cross(normal, [0.0, 1.0, 0.0])
    down = np.cross(normal, across)
    builder.face(np.array([0.0, 0.0, offset]) - 50 * across - 50 * down, 100 * across, 100 * down, white)
    camera = plain_camera()
    x, y = np.meshgrid(np.arange(200.0), np.arange(150.0))
    rays = np.stack([(x - 99.5) / 200, (y - 74.5) / 200, np.ones_like(x)], axis=-1)
    np.testing.assert_allclose(render_depth(builder.build(), camera), offset / (rays @ normal), rtol=1e-6)
    for order in (1, -1):
        builder, (dark, light) = builder_of(40, 220)
        for z, texture in [(10.0, dark), (5.0, light)][::order]:
            plane(builder, texture, z, 2 * z)
        world = builder.build()
        assert (render_depth(world, plain_camera()) == 5.0).all()
        assert (picture(world, plain_camera()) == 220).all()
    builder, (floor,) = builder_of(90)
    builder.face((-50, 1.5, 50), (100, 0, 0), (0, 0, -100), floor)
    depth = render_depth(builder.build(), plain_camera())
    y = np.arange(81, 150)  # the floor ends 50 m away, at row 80.5
    np.testing.assert_allclose(depth[81:, 0], 1.5 * 200 / (y - 74.5), rtol=1e-6)
    assert np.isinf(depth[:80]).all()


def test_a_pixel_carried_over_by_its_depth_lands_on_the_same_colour():
    world, cameras = room(), (camera_at(-2.5), camera_at(3.0, roll_deg=20.0))
    first, second = (picture(world, camera) for camera in cameras)
    depths = [render_depth(world, camera).astype(np.float64) for camera in cameras]
    y, x = np.mgrid[0:HEIGHT:3, 0:WIDTH:3]
    x1 = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    x1 = x1[np.isfinite(depths[0][y.ravel(), x.ravel()])]
    depth1 = depths[0][x1[:, 1].astype(int), x1[:, 0].astype(int)]

    def difference(factor):
        x2, depth2 = reproject(*cameras, x1, depth1 * factor)
        maps = x2[:, None].astype(np.float32)
        seen = cv2.remap(depths[1], maps[..., 0], maps[..., 1], cv2.INTER_NEAREST, borderValue=np.inf)[:, 0]
        visible = np.abs(seen / depth2 - factor) < 0.2 if factor != 1 else np.abs(seen - depth2) < 0.02 * depth2
        colour = cv2.remap(second, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR)[:, 0].astype(float)
        here = first[x1[:, 1].astype(int), x1[:, 0].astype(int)].astype(float)
        assert visible.sum() > 1500
        return np.median(np.abs(colour - here)[visible])

    assert difference(1.0) < 4
    assert difference(1.03) > 3 * difference(1.0)


def test_holes_and_triangles_show_what_is_behind():
    builder, (behind,) = builder_of(40)
    holed = np.full((64, 64, 4), 200, np.uint8)
    holed[16:48, 16:48, 3] = 0
    plane(builder, behind, 10, 20)
    plane(builder, builder.texture(holed), 5, 4)
    builder.face((-1.9, -1.9, 4), (0.8, 0, 0), (0, 0.8, 0), behind, triangle=True)
    depth = render_depth(builder.build(), plain_camera())
    assert (depth[74, 99], depth[74, 99 - 60]) == (10, 5)  # through the hole, and beside it
    assert depth[1, 5] == 4  # at the corner of the triangle, across the image's rim
    assert depth[14, 40] == 5  # where its other half would be


def test_textures_are_the_right_way_round_and_fade_to_grey_far_away():
    image = np.zeros((32, 32, 3), np.uint8)
    image[:16, :16] = (250, 0, 0)  # top left as seen from the front
    builder, _ = builder_of()
    upright(builder, Frame.facing((-3, 3, 8), 0.0), (0, 6), (0, 6), 0.0, texture=builder.texture(image))
    drawn = picture(builder.build(), plain_camera())
    assert drawn[30, 50, 0] > 240
    assert (drawn[30, 150, 0], drawn[120, 50, 0]) == (0, 0)
    board = (np.indices((512, 512)).sum(0) % 2 * 255).astype(np.uint8)
    builder, _ = builder_of()
    plane(builder, builder.texture(np.dstack([board] * 3)), 30, 40)
    inner = picture(builder.build(), plain_camera())[20:130, 40:160].astype(float)
    assert inner.std() < 12
    assert abs(inner.mean() - 127) < 4


def test_roll_turns_things_clockwise():
    eye, target, size = np.array([0.0, -1.7, -10.0]), np.array([0.0, -1.7, 0.0]), {"width": 201, "height": 151}
    cameras = [look_at(eye, target, roll_deg=roll, focal_px=200, **size) for roll in (0, 30)]
    before, after = (camera.project(np.array([[1.0, -1.7, 0.0]]))[0][0] for camera in cameras)
    assert before[1] == pytest.approx(75)
    assert np.degrees(np.arctan2(after[1] - 75, after[0] - 100)) == pytest.approx(30)


def test_the_sun_casts_shadows_and_things_of_one_view_are_in_that_view_only():
    builder, (ground, slab) = builder_of(200, 200)
    builder.face((-30, 2, 40), (60, 0, 0), (0, 0, -60), ground)
    builder.face((-1, 0, 9), (2, 0, 0), (0, 0, -2), slab)
    builder.views = SECOND_VIEW
    plane(builder, slab, 30, 2)
    to_sun, camera, world = np.array([1e-3, 1e-3 - 1, 1e-3]), plain_camera(), builder.build()
    drawn = picture(world, camera, Light(to_sun=to_sun / np.linalg.norm(to_sun), ambient=0.5))
    column, row = camera.project(np.array([[0.0, 2.0, 8.0]]))[0][0].astype(int)  # below the slab
    assert [drawn[row, column, 0], drawn[row, column + 60, 0]] == pytest.approx([100, 200], abs=3)
    assert [render_depth(world, camera, view=view)[71, 99] for view in (FIRST_VIEW, SECOND_VIEW)] == pytest.approx(
        [np.inf, 30]
    )


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_pairs_keep_the_bounds_of_their_family_and_have_the_detail_of_photographs(family):
    settings, pair = FAMILIES[family], render_pair(family, 3, **SMALL)
    cameras, depths = pair.cameras, pair.depths
    x1, x2 = control_points_from_depth(cameras, depths, count=100, seed=0)
    assert len(x1) == 100
    assert sampson_distance(fundamental_from_cameras(*cameras), x1, x2).max() < 1e-6
    seen = pairsets.view_difference(cameras, depths, step=2)
    # Bounds were checked on depth maps of an eighth of the size.
    assert settings.angle_deg[0] - 2 <= seen.angle_deg <= settings.angle_deg[1] + 2
    assert settings.overlap[0] - 0.1 <= seen.overlap <= settings.overlap[1] + 0.1
    roll = min(seen.roll_deg, 360 - seen.roll_deg)
    assert (roll > 10) if family == "rolled" else (roll < 35)
    pair = render_pair(family, 5, width=512, height=384)
    for image in pair.images:
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        assert 15 < grey.std() < 90
        assert len(cv2.SIFT_create().detect(grey)) > 250


@pytest.mark.slow
def test_equal_seeds_give_equal_bytes_and_others_do_not_whatever_the_number_of_workers():
    payload = {"family": "rolled", "width": 128, "height": 96, "jpeg_quality": 92}
    tasks = [Task(name=f"p{k}", payload={"pair_id": f"p{k}", "seed": k % 2, **payload}) for k in range(3)]
    one, two = (map_tasks(render, tasks[: 4 - n], workers=n, description="render") for n in (1, 2))
    for a, b in [*zip(one[:2], two, strict=True), (one[0], one[2])]:
        assert (a.jpegs, a.depths) == (b.jpegs, b.depths)
        np.testing.assert_array_equal(a.cameras[1].t, b.cameras[1].t)
    assert len({*one[0].jpegs, *one[1].jpegs}) == 4


@pytest.mark.slow
def test_a_pair_with_too_few_right_matches_is_drawn_anew(monkeypatch):
    found = iter([14, 3, 15, 99])
    monkeypatch.setattr("epiprior_lab.stages.render.right_among_putative", lambda pair, labels: next(found, 0))
    monkeypatch.setattr("epiprior_lab.stages.render._DRAWS", 4)
    drawn = {"family": "open", "width": 128, "height": 96, "jpeg_quality": 92, "pair_id": "p"}
    how = {"seed": 5, "labels": TRUTH, **drawn}
    chosen, third = render_solvable(least_right=15, **how), render(seed=child_seed(5, "2"), **drawn)
    assert next(found) == 99  # the third draw was taken
    assert (chosen.pair_id, chosen.jpegs, chosen.depths) == ("p", third.jpegs, third.depths)
    assert render_solvable(least_right=0, **how).jpegs == render(seed=5, **drawn).jpegs
    with pytest.raises(SceneError, match="none of 4 draws has 15 right"):
        render_solvable(least_right=15, **how)


@pytest.mark.slow
def test_right_matches_are_counted_by_depth(tmp_path):
    size = {"family": "facades-easy", "width": 512, "height": 384, "jpeg_quality": 92}
    pairsets.write_pair_set(tmp_path, [render(pair_id="p", seed=3, **size)])
    (pair,) = read_pair_set(tmp_path).pairs
    count = right_among_putative(pair, TRUTH)
    assert count > 50
    assert 0 < right_among_putative(pair, dataclasses.replace(TRUTH, tolerance_px=0.3, tolerance_sigma=0.0)) < count
    for path in pair.depth_paths:  # depths of another scene confirm nothing
        path.write_bytes(encode_depth(np.full((384, 512), 2.0, np.float32)))
    assert right_among_putative(read_pair_set(tmp_path).pairs[0], TRUTH) < 0.1 * count


@pytest.mark.slow
def test_scenes_without_two_views_are_an_error_that_names_the_seed(monkeypatch):
    monkeypatch.setattr(pairs, "_WORLDS", 1)
    impossible = dataclasses.replace(FAMILIES["open"], overlap=(0.999, 1.0), angle_deg=(80, 90))
    monkeypatch.setattr(pairs, "FAMILIES", {"open": impossible})
    with pytest.raises(SceneError, match=r"'open', seed 4"):
        render_pair("open", 4, **SMALL)


def test_photographs_are_in_the_installed_packages_and_an_unknown_family_is_refused():
    for name in textures._FILES:
        image = textures.photograph(name)
        assert (image.ndim, image.dtype) == (3, np.uint8)
    assert {*textures.PICTURES, *textures.SURFACES} <= textures._FILES.keys()
    with pytest.raises(SettingsError, match="'closed'"):
        render_pair("closed", 0)


@pytest.mark.parametrize("grain", ["fine", "middle", "coarse"])
def test_noise_has_unit_deviation_and_coarser_grain_is_smoother(grain):
    field = textures.noise(np.random.default_rng(0), 2048, 2048, grain)
    assert field.std() == pytest.approx(1, abs=0.02)
    limits = {"fine": (0.5, 1.4), "middle": (0.1, 0.6), "coarse": (0.0, 0.12)}[grain]
    assert limits[0] < np.abs(np.diff(field, axis=1)).mean() < limits[1]
