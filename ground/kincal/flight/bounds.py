"""What the SPACE table was verified for, against what TERMS let the arm be: flight's own check
(fsw/motion/kc_bounds.h, docs/SPACES.md)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from kincal_shared.errors import BadInput
from kincal_shared.schema.dh import DH_ERRORS

from . import tables
from .builds import library

if TYPE_CHECKING:
    from .headers import KcArm, KcSpace, KcTerms

Place = tuple[int, int]
"""Frame and component of the twist, as flight numbers them."""


@dataclass(frozen=True)
class Excess:
    """Where TERMS let the arm be more than it was verified for."""

    coefficient: str  # with which the sum is too large
    place: str
    sum: float  # [rad or m]
    verified: float  # [rad or m]

    @property
    def text(self) -> str:
        """In words, with both numbers."""
        return (
            f"with {self.coefficient} the arm may be off by {self.sum:.4g} {self.place}; "
            f"the search space was verified for {self.verified:.4g}"
        )


def place_text(place: Place) -> str:
    """Where a term acts, with unit: rad about z of frame 3 (J4.phi_rad)."""
    flight = library("flight")
    frame, comp = place
    special = {flight.constant(f"KC_FRAME_{x}"): x.lower() for x in ("TOOL", "CAMERA", "MEAS")}
    name = flight.enum("kc_comp_t", "KC_")
    axis = next(text for text, number in name.items() if number == comp).lower()
    dh = {e.comp: f"J{e.joint(frame)}.{e.name}" for e in DH_ERRORS if e.joint(frame)}
    how = "rad about" if axis[0] == "r" else "m along"
    where = "the measured pose" if special.get(frame) == "meas" else f"the {special.get(frame)} frame"
    if frame not in special:
        where = f"frame {frame}" + (f" ({dh[axis]})" if axis in dh else "")
    return f"{how} {axis[1]} of {where}"


@dataclass(frozen=True)
class Flown:
    """ARM and SPACE table of a flight: what a term can do, and what was verified."""

    arm: KcArm
    space: KcSpace

    @classmethod
    def read(cls, folder: Path) -> Flown:
        """Those of a folder. BadInput if one is missing or damaged, or they do not belong together."""
        for kind in ("arm", "space"):
            if not (folder / f"{kind}.tbl").is_file():
                raise BadInput(
                    f"holds no {kind}.tbl: bounds of correction terms are those that the search space was "
                    "verified for",
                    str(folder),
                    "name the folder of the tables that fly with --tables",
                )
        arm_path, space_path = folder / "arm.tbl", folder / "space.tbl"
        image, arm = tables.decode_as("arm", arm_path.read_bytes(), str(arm_path))
        space = tables.decode_as("space", space_path.read_bytes(), str(space_path))[1]
        if space.arm_crc != image.crc:
            raise BadInput(
                f"was built for the ARM table {space.arm_crc:08x}, that of this folder is {image.crc_text}",
                str(space_path),
                "`kincal space build` it for this arm",
            )
        return cls(arm, space)

    def size(self, terms: KcTerms, k: int) -> float:
        """Largest size of term k per unit of its coefficient [rad or m]."""
        flight = library("flight")
        return float(flight.lib.kc_bounds_size(self.arm, flight.address(terms.term[k])))

    def allowed(self, place: Place) -> float:
        """What the bounds of all coefficients may add up to at a place [rad or m]."""
        flight = library("flight")
        verified = float(flight.lib.kc_bounds_verified(self.space, *place))
        return flight.decimal("KC_BOUNDS_EXCESS") * verified

    def excess(self, terms: KcTerms) -> Excess | None:
        """Why flight would refuse TERMS beside this SPACE; None if it would not."""
        flight = library("flight")
        bad = flight.new("kc_bounds_bad_t")
        if flight.lib.kc_bounds_check(self.space, self.arm, terms, bad) == 0:
            return None
        place = place_text((bad.frame, bad.comp))
        return Excess(flight.text(terms.coef[bad.coef].name), place, bad.sum, bad.verified)


# --------------------------------------------------------------------------- bounds for a table

SHARE = 0.5  # of what is allowed that effects may take where a DH error acts too


def shared_bounds(flown: Flown, terms: KcTerms, wanted: Mapping[int, float]) -> list[float]:
    """Bound of every coefficient of a term table, so that flight accepts it.

    wanted: bounds of effects, by the number of their coefficient. They get them, or less where they would
    take more than their share of what the space was verified for; the other coefficients, the DH errors, get
    the rest, in equal parts where several act at one place."""
    acts: dict[Place, dict[int, float]] = defaultdict(lambda: defaultdict(float))
    for k in range(terms.n_term):
        term = terms.term[k]
        acts[term.frame, term.comp][term.coef] += flown.size(terms, k)
    bounds = dict(wanted)
    for place, sizes in acts.items():
        effects = {c: size for c, size in sizes.items() if c in wanted}
        room = flown.allowed(place) * (SHARE if len(effects) < len(sizes) else 1.0)
        taken = sum(wanted[c] * size for c, size in effects.items())
        if taken > room:
            for c in effects:
                bounds[c] = min(bounds[c], wanted[c] * room / taken)
    for place, sizes in acts.items():
        others = {c: size for c, size in sizes.items() if c not in wanted}
        rest = flown.allowed(place) - sum(bounds[c] * size for c, size in sizes.items() if c in wanted)
        for c, size in others.items():
            bounds[c] = min(bounds.get(c, rest / size / len(others)), rest / size / len(others))
    return [max(bounds.get(c, 0.0), 0.0) for c in range(terms.n_coef)]


def tightest(flown: Flown, terms: KcTerms, coef: int, value: float) -> tuple[Place, float, float]:
    """Where a coefficient of this value takes most of what is allowed: the place, what it does there, and
    what is allowed [rad or m]."""
    at: dict[Place, float] = defaultdict(float)
    for k in range(terms.n_term):
        if terms.term[k].coef == coef:
            at[terms.term[k].frame, terms.term[k].comp] += abs(value) * flown.size(terms, k)
    place = max(at, key=lambda p: at[p] / max(flown.allowed(p), 1e-12))
    return place, at[place], flown.allowed(place)
