"""From a correction under review to the workbench and back: its measurements as a case, a model as a TERMS
table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kincal.api.models import for_flight
from kincal.flight import Arm
from kincal.link import write_image
from kincal.link.eventfile import event_bytes
from kincal.review import parse_crc
from kincal_shared.errors import BadInput, KincalError
from kincal_shared.schema.arm import read_arm

from .bench import Bench
from .job import MODEL
from .picture import Picture
from .shelf import MADE, Shelf

Plain = dict[str, Any]


def take(bench: Bench, picture: Picture, crc: str) -> Plain:
    """The measurements of a correction become the case of the workbench, and their diagnosis begins. BadInput
    if they were not heard, or no arm table of the workbench is flight's; CommandFailed if it is at work."""
    parse_crc(crc)
    proposal = picture.proposal(crc)
    session = picture.summary().sessions.get(proposal.session) if proposal else None
    if proposal is None or session is None or not session.measurements:
        raise BadInput(
            f"the measurements of correction {crc} were not heard by this console",
            todo="upload its recording in Workbench",
        )
    bench.work.refuse_two()
    name = f"correction-{crc}.lcmlog"
    heard = enumerate(session.measurements, 1)
    data = b"".join(event_bytes(n, m.t_us, "KC_MEAS", m.encode()) for n, m in heard)
    path = bench.uploads / name
    if path.exists() and path.read_bytes() != data:
        path.unlink()  # what was heard of it before was less, or more
    bench.upload(name, data)
    bench.choose(arm_name(bench, picture.geometry.arm), f"uploaded: {name}")
    return bench.run("diagnose") | {"text": f"diagnosis of the measurements of correction {crc} began"}


def arm_name(bench: Bench, flown: Arm) -> str:
    """Arm table of the workbench with the kinematics that fly, one of the user's before those that ship."""
    arms = [(name, file) for name, file in bench.files().items()
            if name.startswith("shipped") or name.endswith(".toml")]  # fmt: skip
    for name, file in sorted(arms, key=lambda one: one[0].startswith("shipped")):
        try:
            if Arm.of(read_arm(file)).kinematics_crc == flown.kinematics_crc:
                return name
        except KincalError:
            continue  # another kind of file, or an arm that flight cannot carry
    raise BadInput(
        "no arm table of the workbench has the kinematics that fly",
        todo="upload the arm's TOML in Workbench, then choose the measurements there",
    )


def uplink(bench: Bench, shelf: Shelf, drop: list[str]) -> Plain:
    """The fitted model as a TERMS table among those that can be sent, as `kincal model uplink`. BadInput if
    the fit is of another case, or flight could not carry the model."""
    if not bench.answer("fit")["current"]:
        raise BadInput("the fit is of another model or other measurements", todo="fit once more")
    made = for_flight(bench.file("fit", MODEL), shelf.flown(), drop=drop)
    write_image(made.image, shelf.place("TERMS", MADE))
    left = f"; left out: {', '.join(h.name for h in made.left_out)}" if made.left_out else ""
    effects = [h.name for h in made.effects if h not in made.left_out]
    return {
        "ok": True,
        "crc": made.image.crc_text,
        "file": str(Path(shelf.place("TERMS", MADE))),
        "effects": effects,
        "text": f"TERMS table {made.image.crc_text} with {', '.join(effects) or 'DH errors alone'}{left}",
        "about": f"{made.compared}; bounds within what the search space was verified for, plus a tenth",
    }
