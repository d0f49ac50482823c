"""Arms that are wrong: the DH errors a search space has to survive."""

from __future__ import annotations

import numpy as np

from .bodies import FIELDS
from .description import Description


def bounds(desc: Description, n_joints: int) -> dict[str, float]:
    """Largest error to survive of every DH parameter, by name; parameters without one are left out."""
    out = {}
    for j in range(n_joints):
        for f in FIELDS:
            if (value := getattr(desc.survive, f)[j]) > 0.0:
                out[f"J{j + 1}.{f}"] = value
    return out


def draw(desc: Description, n_joints: int) -> list[dict[str, float]]:
    """Named cases, then every large error alone at both bounds, then corners: so many errors of any size at
    their bounds together, which ones and which way drawn from the seed."""
    size = bounds(desc, n_joints)
    names = list(size)
    rng = np.random.default_rng([desc.seed, 1])
    out = [dict(c) for c in desc.survive.case]
    least = {True: desc.survive.alone_rad, False: desc.survive.alone_m}
    large = [name for name in names if size[name] >= least[name.endswith("_rad")]]
    out += [{name: sign * size[name]} for name in large for sign in (1.0, -1.0)]
    for _ in range(desc.survive.draws if names else 0):
        chosen = rng.choice(len(names), min(desc.survive.errors, len(names)), replace=False)
        out.append({names[k]: float(rng.choice([-1.0, 1.0])) * size[names[k]] for k in chosen})
    return out
