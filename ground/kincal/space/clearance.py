"""Distance of the arm to itself and its surroundings, for the nominal arm and under all sampled errors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kincal_shared.schema.space import Description

from .arrays import Floats
from .collision import CollisionModel
from .error_sampling import sampled_errors

if TYPE_CHECKING:
    from kincal.flight.headers import KcArm, KcCamera


@dataclass(frozen=True)
class ErrorContact:
    """Shapes in contact ("a - b") on the arm with `errors` (DH errors by name)."""

    pair: str
    errors: dict[str, float]


class Clearance:
    """Collision models of one description: the nominal arm, the nominal arm with thicker links (for lines of
    sight), and one arm for each set of sampled errors."""

    def __init__(self, desc: Description, arm: KcArm, camera: KcCamera) -> None:
        self.step_rad = desc.clear.step_rad
        self.nominal = CollisionModel(desc, arm, camera, None, desc.clear.nominal_m)
        self.thick = CollisionModel(desc, arm, camera, None, 0.0, desc.sight.margin_m)
        self.errors = sampled_errors(desc, int(arm.n_joints))
        self.wrong = [CollisionModel(desc, arm, camera, e, desc.clear.perturbed_m) for e in self.errors]

    @property
    def arms(self) -> list[CollisionModel]:
        """The nominal arm, then those with errors."""
        return [self.nominal, *self.wrong]

    def contact_with_errors(self, q_rad: Floats) -> ErrorContact | None:
        """First contact of an arm with errors at joints q."""
        for errors, arm in zip(self.errors, self.wrong, strict=True):
            if pair := arm.contact(q_rad):
                return ErrorContact(pair, errors)
        return None

    def segment_contact(self, a_rad: Floats, b_rad: Floats) -> str:
        """First pair in contact on the straight joint-space segment, both ends included, or an empty
        string."""
        postures = segment_postures(a_rad, b_rad, self.step_rad)
        return _first_contact((arm, q) for arm in self.arms for q in postures)

    def box_contact(self, lo: Floats, hi: Floats, samples: int, rng: np.random.Generator) -> str:
        """First pair in contact at sampled postures of a joint-space box, or an empty string. Half of the
        postures are corners; the arms take turns."""
        arms = self.arms
        first = int(rng.integers(len(arms)))
        u = rng.random((samples, len(lo)))
        u[1::2] = np.round(u[1::2])
        postures = enumerate(lo + (hi - lo) * u, first)
        return _first_contact((arms[i % len(arms)], q) for i, q in postures)


def segment_postures(a_rad: Floats, b_rad: Floats, step_rad: float) -> list[Floats]:
    """Postures on the straight joint-space segment at which it is verified, both ends included; no joint
    moves farther than the step from one to the next."""
    n = max(int(np.ceil(np.max(np.abs(b_rad - a_rad)) / step_rad)), 1)
    return [a_rad + (b_rad - a_rad) * s for s in np.linspace(0.0, 1.0, n + 1)]


def _first_contact(tries: Iterable[tuple[CollisionModel, Floats]]) -> str:
    return next((pair for arm, q in tries if (pair := arm.contact(q))), "")


def errors_text(errors: dict[str, float]) -> str:
    """DH errors as text, "J7.phi_rad +1.30, J3.d_m +0.15"."""
    return ", ".join(f"{name} {value:+.2f}" for name, value in errors.items())
