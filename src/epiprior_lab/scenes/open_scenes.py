"""Open places: houses, boards, rocks, crates, trees and walls at many depths, all around a middle."""

from __future__ import annotations

import numpy as np

from epiprior_lab.scenes.camera_pairs import Subject
from epiprior_lab.scenes.clutter import FURNITURE, PASSING, add_crates, add_poster_board
from epiprior_lab.scenes.facades import add_house, house_style
from epiprior_lab.scenes.placing import scatter
from epiprior_lab.scenes.rocks import add_rock
from epiprior_lab.scenes.settings import FamilySettings
from epiprior_lab.scenes.streets import begin_world
from epiprior_lab.scenes.world import BOTH_VIEWS, FIRST_VIEW, SECOND_VIEW, Frame, World

_TEXELS_PER_M = 48.0


def draw_open_scene(rng: np.random.Generator, settings: FamilySettings) -> tuple[World, Subject]:
    """Draw a place about 25 m wide: houses behind, single things before them, some close to the viewer."""
    world = begin_world(rng)
    across = -16.0
    while across < 14.0:
        wide, turn = float(rng.uniform(4, 9)), float(rng.uniform(-35, 35))
        style = house_style(
            rng,
            distinct=float(rng.uniform(*settings.distinct)),
            variety=float(rng.uniform(*settings.variety)),
            texels_per_m=_TEXELS_PER_M,
        )
        place = Frame.facing((across, 0.0, float(rng.uniform(2, 10))), turn)
        add_house(
            world,
            rng,
            place,
            style,
            width=wide,
            height=float(rng.uniform(3, 8)),
            depth=float(rng.uniform(4, 7)),
        )
        across += wide + float(rng.uniform(1.5, 5.0))
    features = (add_rock, add_crates, add_poster_board)
    scatter(world, rng, features, count=5, across=(-4.0, 4.0), before=(-1.5, 3.5), view=BOTH_VIEWS)
    count = int(rng.integers(8, 15))
    scatter(world, rng, FURNITURE, count=count, across=(-9.0, 9.0), before=(-6.0, 4.0), view=BOTH_VIEWS)
    for view in (FIRST_VIEW, SECOND_VIEW):
        count = round(rng.uniform(*settings.passing))
        scatter(world, rng, PASSING, count=count, across=(-6.0, 6.0), before=(0.5, 4.0), view=view)
    subject = Subject(
        frame=Frame.facing((0.0, 0.0, 0.0), 0.0),
        distance_m=(7.0, 11.0),
        obliquity_deg=70.0,
        aim_across_m=(-2.5, 2.5),
        aim_up_m=(1.0, 2.2),
        eye_m=(1.4, 3.0),
    )
    return world.build(), subject
