"""Seeds that depend on what is computed, never on when or by which worker."""

import hashlib

import numpy as np


def child_seed(base: int, *names: str) -> int:
    """Return the seed of one named piece of work, in ``[0, 2**31)``: accepted by all libraries that draw at random.

    `base`, 0 or more, is the seed of the whole; `names` say what the seed is for, the general first,
    such as ``("render", "open-test-0003")``. They are hashed one by one: ``("a", "bc")`` is not ``("ab", "c")``.
    """
    words = [base]
    for name in names:
        digest = hashlib.sha256(name.encode()).digest()
        words.extend(int.from_bytes(digest[i : i + 4], "little") for i in range(0, len(digest), 4))
    return int(np.random.SeedSequence(words).generate_state(1)[0] >> 1)
