"""Joint readings that a file states together with those of another joint: `[readings]` of the map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..numerics.types import Array, array

Sums = Sequence[tuple[str, str]]
"""(q3, "q3 + q2"): a joint, and what it is of the readings in the file."""


def of_joints(q: Array, sums: Sums) -> Array:
    """(N, n) what the joints do, of the readings in the file."""
    return array(q @ matrix(sums, q.shape[1]).T)


def of_file(q: Array, sums: Sums) -> Array:
    """(N, n) the readings in the file, of what the joints do."""
    return array(np.linalg.solve(matrix(sums, q.shape[1]), q.T).T)


def matrix(sums: Sums, n: int) -> Array:
    """(n, n) from the readings in the file to what the joints do."""
    out = np.eye(n)
    for name, text in sums:
        one, sign, other = text.split()
        to, first, second = (int(q_j[1:]) - 1 for q_j in (name, one, other))
        out[to] = 0.0
        out[to, first] = 1.0
        out[to, second] = 1.0 if sign == "+" else -1.0
    return out


def of_the_joints(sums: Sums) -> str:
    """Of joint values that a controller may be given."""
    return f"values are those of the joints, what a controller calls them follows by {in_words(sums)}"


def in_words(sums: Sums) -> str:
    """As the map file has them."""
    return "[readings] " + ", ".join(f'{name} = "{text}"' for name, text in sums)
