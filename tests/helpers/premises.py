"""What a test takes for granted: arrangements that look random, and are the same in every run."""

from collections.abc import Sequence

import numpy as np


def premise(seed: int | Sequence[int]) -> np.random.Generator:
    """Return a generator for the scene, the unit or the light that a test starts from.

    TEST_SEED draws the noise anew, for which a test states a rate. What it is the noise of stays: whether a frame has
    enough walls, or a truth can be told from its neighbour, is no matter of luck.
    """
    return np.random.Generator(np.random.PCG64(seed))
