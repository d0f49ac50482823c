"""Names of types that the workbench uses throughout."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
Groups = NDArray[np.int_]


def array(x: ArrayLike) -> Array:
    """x as an array of double: what the type checker cannot see of expressions of arrays."""
    return np.asarray(x, dtype=np.float64)


Progress = Callable[[str, int, int], None]
"""progress(what, done, of): called by long computations before each of their steps."""


def no_progress(_what: str, _done: int, _of: int) -> None:
    """The callback of a caller who does not want to be called."""
