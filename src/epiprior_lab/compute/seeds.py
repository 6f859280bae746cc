"""Seeds that depend on what is computed, never on when or by which worker."""

import hashlib

import numpy as np

from epiprior.errors import SettingsError


def child_seed(base: int, *names: str) -> int:
    """Return the seed of one named piece of work.

    Parameters
    ----------
    base : int
        Seed of the whole, ``>= 0``.
    *names : str
        What the seed is for, the general before the particular, for example ``("render", "open-test-0003")``.

    Returns
    -------
    int
        In ``[0, 2**31)``: accepted by numpy, scikit-learn, LightGBM, OpenCV and PoseLib alike.

    Raises
    ------
    SettingsError
        If `base` is negative.

    Notes
    -----
    Names are hashed one by one, so ``("a", "bc")`` and ``("ab", "c")`` are different children.
    """
    if base < 0:
        raise SettingsError(f"seed = {base}: expected an integer >= 0")
    words = [base]
    for name in names:
        digest = hashlib.sha256(name.encode()).digest()
        words.extend(int.from_bytes(digest[i : i + 4], "little") for i in range(0, len(digest), 4))
    return int(np.random.SeedSequence(words).generate_state(1)[0] >> 1)
