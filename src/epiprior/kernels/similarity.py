"""The inner product of two descriptors, for the few pairs of which a matrix product would compute too many."""

import numpy as np

from epiprior.kernels.compilation import compiled


@compiled(fastmath={"contract", "reassoc", "nsz"})
def inner_product(a, b):  # type: ignore[no-untyped-def]
    """Return the inner product of two rows, float32; summed in as many parts as a vector of the processor holds."""
    total = np.float32(0)
    for k in range(len(a)):
        total += a[k] * b[k]
    return total
