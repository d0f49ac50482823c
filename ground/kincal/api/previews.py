"""What a rollback would bring back, and what a correction would change that waits on board and was not
recorded: values, clearance and reach, and where all that comes from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from kincal.flight.tables import Image, decode_as
from kincal.link import CommandLink, unsigned32, write_image
from kincal.review import KIN_KIND, changes
from kincal.review.changes import Changes, Flown, KinValues
from kincal.review.decisions import OnBoard, Operator
from kincal_shared.errors import BadInput, CommandFailed, KincalError

from . import corrected, operate
from .corrected import Corrected
from .reviews import clearance_dict, known_or_why

READ_BACK_S = 60.0
"""Longest time for a table that flight is asked for."""

# ---- a rollback


@dataclass(frozen=True)
class RolledBack:
    """What a rollback changes back, with clearance and reach of the arm as the table before has it, against
    the one in force; why_not: why these are not known. now, before: the table in force and the one that comes
    back, with what is known of them."""

    changes: Changes
    now: KinValues
    before: KinValues
    corrected: Corrected | None = None
    why_not: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain data for --json."""
        return {
            "from": f"{self.now.crc:08x}",
            "to": f"{self.before.crc:08x}",
            "changes": self.changes.as_dict(),
            **clearance_dict(self.corrected, self.why_not),
        }


def what_rolls_back(
    table_crc: Sequence[int],
    crc_before: int,
    tables_dir: Path,
    places: Sequence[Path] = (),
    description: Path | None = None,
) -> RolledBack:
    """What a rollback changes back; both as in KC_HK (table_crc, kin_prev_crc). BadInput if there is no table
    to go back to, or the values of one of them are in none of the places. description: of the SPACE table, if
    it is not found."""
    now, previous = _both(unsigned32(table_crc[KIN_KIND]), unsigned32(crc_before), (tables_dir, *places))
    wanted = corrected.in_force(table_crc)

    def compute() -> Corrected:
        return corrected.between(now.values, previous.values, tables_dir, description, wanted=wanted)

    return rolled_back(now, previous, tables_dir, wanted, *known_or_why(compute, description))


def rolled_back(
    now: KinValues,
    previous: KinValues,
    tables_dir: Path,
    wanted: Mapping[str, int],
    clear: Corrected | None,
    why_not: str,
) -> RolledBack:
    """From the table in force to the one before it. wanted: CRCs of the tables in force."""
    found = changes.of_rollback(now, previous, *_named(tables_dir, wanted))
    return RolledBack(_with_reasons(found, clear), now, previous, clear, why_not)


def _with_reasons(found: Changes, clear: Corrected | None) -> Changes:
    return found if clear is None else replace(found, reasons=(*found.reasons, *clear.reasons))


def _named(tables_dir: Path, wanted: Mapping[str, int]) -> tuple[list[str], Flown | None]:
    """Names of the coefficients and tables of a folder, as far as they are those that are wanted: with others
    values would get wrong names."""
    differ = corrected.misfits(tables_dir, wanted)
    names = [] if "terms" in differ else changes.names_of(tables_dir)
    return names, None if {"arm", "terms"} & differ.keys() else changes.flown(tables_dir)


def _both(crc_in_force: int, crc_before: int, where: Sequence[Path]) -> tuple[KinValues, KinValues]:
    """The table in force and the one before it."""
    if not crc_before:
        raise BadInput(
            f"flight holds no table before {crc_in_force:08x} and refuses to roll back",
            todo="`kincal table uplink FILE` brings a KIN table in force that you have",
        )
    now = changes.kin_values(crc_in_force, where)
    if now is None:
        raise BadInput(
            f"the values of correction {crc_in_force:08x} are in none of the places looked at",
            ", ".join(map(str, where)),
            "`kincal table dump kin now.tbl`, then --from now.tbl; or --from LOG that holds its proposal",
        )
    previous = changes.kin_values(crc_before, where)
    if previous is None:
        raise BadInput(
            f"a rollback brings back {crc_before:08x}, whose values are in none of the places looked at",
            ", ".join(map(str, where)),
            "--from LOG that holds its proposal, or --from the KIN table",
        )
    return now, previous


# ---- what waits and was not recorded


@dataclass(frozen=True)
class Asked:
    """What waits on board, by its table as flight holds it: values and sigmas without covariance, fit and
    residuals. sources: where everything comes from, a sentence each."""

    crc: str
    verdict: str
    changes: Changes
    sources: tuple[str, ...]
    corrected: Corrected | None = None
    why_not: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain data for --json."""
        return {
            "crc": self.crc,
            "verdict": self.verdict,
            "recorded": False,
            "sources": list(self.sources),
            "changes": self.changes.as_dict(),
            **clearance_dict(self.corrected, self.why_not),
        }


def asked_for(
    link: CommandLink,
    waits: OnBoard,
    tables_dir: Path,
    into: Path,
    who: Operator,
    places: Sequence[Path] = (),
    description: Path | None = None,
) -> Asked:
    """The correction that waits on board, asked of flight. Tables of the folder that are not those in force
    are read back; into: an empty folder where those in force are gathered; who: asks, for the journal."""
    asked = _Asks(link, who)
    image = asked.read_back("proposal")
    if image.crc != waits.crc:
        todo = "another correction waits by now: try again"
        raise CommandFailed(f"flight sent table {image.crc_text}, {waits.crc:08x} waits", link.url, todo)
    kin, wanted = decode_as("kin", image.data, link.url)[1], corrected.in_force(waits.table_crc)
    said, missing = _gather(asked, tables_dir, wanted, into)
    old, was = _old(asked, unsigned32(kin.prev_crc), (tables_dir, *places))
    n = int(kin.n_coef)
    values, sigmas = tuple(kin.value[0:n]), tuple(kin.sigma[0:n])
    found = changes.of_values(values, sigmas, old, *_named(into, wanted))

    def compute() -> Corrected:
        if missing:
            raise BadInput("; ".join(missing), str(tables_dir), "--tables DIR with the tables in force")
        beside = tables_dir / "space.toml", tables_dir.parent / "src" / "space.toml"
        file = description or corrected.description_of(into, beside)
        before = old.values if old else None
        return corrected.between(before, values, into, file, wanted=wanted, said=said)

    clear, why = known_or_why(compute, description)
    sources = (f"proposed: table {image.crc_text}, read from flight now", was, f"with {said}")
    return Asked(image.crc_text, waits.verdict, _with_reasons(found, clear), sources, clear, why)


@dataclass
class _Asks:
    """Reads tables back from flight, each with its lines in the journal."""

    link: CommandLink
    who: Operator
    heard: operate.Snapshot = field(default_factory=operate.Snapshot)

    def read_back(self, kind: str) -> Image:
        return operate.read_back(self.link, kind, self.who, READ_BACK_S, self.heard)


def _gather(asked: _Asks, tables_dir: Path, wanted: Mapping[str, int], into: Path) -> tuple[str, list[str]]:
    """The tables in force in one folder: from another one if they lie there, else read back from flight.
    Where they came from, and which could not be had, in words."""
    differ = corrected.misfits(tables_dir, wanted)
    came, missing = [], []
    for kind in corrected.KINDS:
        file = tables_dir / f"{kind}.tbl"
        if kind not in differ and file.is_file():
            (into / file.name).write_bytes(file.read_bytes())
            continue
        try:
            image = asked.read_back(kind)
            write_image(image, into / file.name)
            came.append(f"{kind.upper()} {image.crc_text}")
        except KincalError as error:
            missing.append(f"{differ.get(kind, kind.upper())}, and it could not be read back: {error.what}")
    left = [kind.upper() for kind in corrected.KINDS if kind not in differ]
    said = [f"{', '.join(left)} of {tables_dir}"] if left else []
    said += [f"{', '.join(came)} read back from flight, which the folder does not have"] if came else []
    return "; ".join(said) or "no table", missing


def _old(asked: _Asks, crc: int, places: Sequence[Path]) -> tuple[KinValues | None, str]:
    """The table that a proposal replaces, and where it was found; None if it replaces none."""
    if not crc:
        return KinValues(0, ()), "in force: no correction, the nominal arm"
    if (found := changes.kin_values(crc, places)) is not None:
        return found, f"in force: table {crc:08x} of {found.where}"
    try:
        image = asked.read_back("kin")
        if image.crc != crc:
            return None, f"in force: table {crc:08x} is not at hand (flight sent {image.crc_text})"
    except KincalError as error:
        return None, f"in force: table {crc:08x} is not at hand ({error.what})"
    url = asked.link.url
    kin = decode_as("kin", image.data, url)[1]
    return KinValues(crc, tuple(kin.value[0 : kin.n_coef]), url), f"in force: table {crc:08x}, read back"
