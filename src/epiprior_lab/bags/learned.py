"""A bag by a learned matcher, in its own environment; like `evaluation.learned`, this imports nothing of epiprior.

So what is stored of it holds whatever becomes of the library.
"""

import itertools
import os
from collections.abc import Sequence
from pathlib import Path

from epiprior_lab.evaluation.learned import Columns, match_learned


def match_bag(*, images: Sequence[Path], peer: str, python: Path, script: Path) -> tuple[list[Columns], float]:
    """Match all pairs of a bag, in order, as `match_learned` does; return the processor seconds that it took as well.

    These include the start of torch.
    """
    before = sum(os.times()[:4])
    found = match_learned(images=list(itertools.combinations(images, 2)), peer=peer, python=python, script=script)
    return found, sum(os.times()[:4]) - before
