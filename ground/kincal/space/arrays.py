"""Types of numpy arrays. Shapes and units stand in the docstrings of who takes and gives them."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from kincal.rotations import Floats

Ints: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]

__all__ = ["Bools", "Floats", "Ints"]
