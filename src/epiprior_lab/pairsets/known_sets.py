"""The pair sets that this project knows by name, whether somebody has them here or not.

Names are folder names. The paper's sets cannot be passed on by us; ``docs/pair-sets.md`` says what is known of them.
"""

import re
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class KnownSet:
    """A published set of image pairs: `name` is its folder, `title` for tables; the paper has results on a `paper` set.

    The first group of the regular expression `scene_pattern`, matched against the stem of an image file, is the scene;
    where it is empty all pairs are one scene.
    """

    name: str
    title: str
    pairs: int
    paper: bool = False
    scene_pattern: str = ""

    def scene(self, image_stem: str) -> str:
        """Return the scene of an image by its name; the set's name where the pattern says nothing."""
        found = re.match(self.scene_pattern, image_stem) if self.scene_pattern else None
        return found.group(1) if found else self.name

    def present(self, folder: Path) -> bool:
        """Return whether `folder` holds this set."""
        return (folder / self.name / "pairs.csv").is_file()


_NAME_AND_NUMBER = r"(.+?)[_-]?\d+$"

KNOWN_SETS = (
    # The paper counts 137 test pairs in ZuBuD1: two of its 139 were used for training.
    KnownSet(name="zubud1", title="ZuBuD1", pairs=137, paper=True, scene_pattern=r"(object\d+)"),
    KnownSet(name="zubud2", title="ZuBuD2", pairs=137, paper=True, scene_pattern=r"(object\d+)"),
    KnownSet(name="blogs", title="BLOGS", pairs=20, paper=True, scene_pattern=_NAME_AND_NUMBER),
    KnownSet(name="usac", title="USAC", pairs=11, paper=True),
    KnownSet(name="urban", title="Urban", pairs=108, paper=True),
    KnownSet(name="open1", title="Open1", pairs=246, paper=True),
    KnownSet(name="open2", title="Open2", pairs=224, paper=True),
    KnownSet(name="strecha", title="Strecha", pairs=120),
    KnownSet(name="kusvod2", title="kusvod2", pairs=24),
    KnownSet(name="adelaidermf", title="AdelaideRMF", pairs=21),
    KnownSet(name="middlebury", title="Middlebury", pairs=43),
    KnownSet(name="fox", title="fox", pairs=30),
    KnownSet(name="can_yhu", title="can_yhu", pairs=24),
    KnownSet(name="sceaux", title="Sceaux", pairs=27),
    KnownSet(name="monstree", title="monstree", pairs=30),
    KnownSet(name="vggsfm_examples", title="VGGSfM examples", pairs=53),
    KnownSet(name="bundler_toys", title="Bundler toys", pairs=58),
    KnownSet(name="cs143", title="CS 143", pairs=3),
    KnownSet(name="scannet15", title="ScanNet, 15 pairs", pairs=15),
)


def known_sets(*, paper: bool | None = None) -> tuple[KnownSet, ...]:
    """Return the known sets in the order of tables, the paper's first; with `paper`, only those or only the others."""
    return tuple(known for known in KNOWN_SETS if paper is None or known.paper == paper)
