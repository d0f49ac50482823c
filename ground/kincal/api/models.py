"""Model files: the effects in use, and the term table that flight gets of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kincal.flight.bounds import Flown
from kincal.flight.tables import Image
from kincal.workbench.consistency import refuse_model_of_other_arm
from kincal.workbench.data.measurements import Measurements
from kincal.workbench.diagnosis.unnamed_effects import Found, find_unnamed
from kincal.workbench.evidence.constants import Choice, choose_constants
from kincal.workbench.model.effects import Hypothesis, Library
from kincal.workbench.model.modelfile import ModelFile, held, read_model, replace_model, write_model
from kincal.workbench.model.unnamed_names import UnnamedName
from kincal.workbench.model.uplink import dropped, refuse_other_arm, term_image
from kincal.workbench.numerics.types import Progress, no_progress
from kincal.workbench.prediction.nested import EffectGain, cost_without
from kincal_shared.errors import BadInput
from kincal_shared.letters import shown
from kincal_shared.schema.arm import MAX_JOINTS, ArmTable, read_arm
from kincal_shared.schema.names import UNNAMED, is_unnamed, split_constants

_USUAL_JOINTS = 8  # most arms have no more, and flight carries no more
_JOINT = re.compile(r" *0*[1-9][0-9]{0,2} *")

Read = Callable[[ArmTable], Measurements]
"""Reads the measurements of an arm."""


def load_model(
    model_path: Path | None,
    effect_files: Sequence[Path] = (),
    arm: ArmTable | None = None,
    *,
    must_exist: bool = True,
) -> tuple[ModelFile, Library]:
    """Model file and the library with its own and the named effect files. BadInput if the model is of another
    arm than `arm`, or absent and must_exist."""
    model = read_model(model_path, must_exist=must_exist) if model_path else ModelFile()
    if arm is not None:
        refuse_model_of_other_arm(model, arm, str(model_path))
    base = model_path.parent if model_path else Path()
    files = list(dict.fromkeys([*(base / name for name in model.libraries), *effect_files]))
    return model, Library.load(*files).with_unnamed(model.unnamed.values())


def place_of(arm_path: Path) -> str:
    """What a model file keeps of the arm table that was named: where it is, or the name of a shipped one."""
    return str(arm_path.resolve()) if arm_path.is_file() else str(arm_path)


def arm_of(chosen: ModelFile, model_path: Path, arm_path: Path | None) -> Path:
    """The arm table that was named, else the one that the model was begun or fitted with."""
    if arm_path is None and not chosen.arm:
        raise BadInput(
            "the model file does not say which arm it is for",
            str(model_path),
            "`kincal model fit` first, or name the arm table by --arm",
        )
    return arm_path or Path(chosen.arm)


@dataclass(frozen=True)
class Added:
    """A model with new effects, not written yet, and what was found of the unnamed ones."""

    model: ModelFile
    found: Found


def add_effects(
    model_path: Path,
    names: Sequence[str],
    effect_files: Sequence[Path] = (),
    arm_path: Path | None = None,
    read: Read | None = None,
    progress: Progress = no_progress,
) -> Added:
    """The model of a file (a new one if there is none) with these effects too.

    read: the measurements that the terms of unnamed effects are chosen from. BadInput for an unknown name, a
    joint that the arm does not have, an effect that is there already, an arm that is not the model's,
    measurements without an arm, or an unnamed effect without either.
    """
    before = read_model(model_path, must_exist=False)
    files = [model_path.parent / name for name in before.libraries] + list(effect_files)
    library = Library.load(*files)
    wanted = [str(UnnamedName.parse(name)) if is_unnamed(name) else name for name in names]
    before.add([name for name in wanted if name != UNNAMED])  # said before the work is done
    where = arm_path or (Path(before.arm) if before.arm else None)
    arm = read_arm(where) if where else None
    if arm is None and read is not None:
        raise BadInput("measurements are read by the arm table that they are of", todo="name it by --arm")
    if arm is not None and arm_path is not None:
        refuse_model_of_other_arm(before, arm, str(model_path))
    check_names(library, wanted, arm)
    library.check_once((*before.effects, *(split_constants(name)[0] for name in wanted)))
    found = _found_in_data(before, library, where, read, wanted, progress)
    after = before.add(list(found.names)) if found.names else before
    for addition in found.additions:
        after = after.with_terms(addition.effect.entry())
    new = [str(f.resolve()) for f in effect_files if str(f.resolve()) not in before.libraries]
    of_arm = before.arm or (place_of(arm_path) if arm_path else "")
    return Added(replace(after, libraries=(*before.libraries, *new), arm=of_arm), found)


def change_by_adding(
    model_path: Path,
    names: Sequence[str],
    effect_files: Sequence[Path] = (),
    arm_path: Path | None = None,
    read: Read | None = None,
    progress: Progress = no_progress,
) -> Added:
    """As `add_effects`, and the file is written. Other commands that change it wait for names alone; for an
    unnamed effect, whose terms take long to find, BadInput if one of them was quicker."""
    if any(name == UNNAMED or is_unnamed(name) for name in names):
        added = add_effects(model_path, names, effect_files, arm_path, read, progress)
        replace_model(model_path, added.model)
        return added
    with held(model_path):
        added = add_effects(model_path, names, effect_files, arm_path, read, progress)
        write_model(model_path, added.model)
    return added


def _found_in_data(
    chosen: ModelFile,
    library: Library,
    where: Path | None,
    read: Read | None,
    names: Sequence[str],
    progress: Progress,
) -> Found:
    """Effects to add to a model, the unnamed ones among them with terms from the measurements."""
    unnamed = next((name for name in names if name == UNNAMED or is_unnamed(name)), None)
    if unnamed is None:
        return Found(tuple(names))
    if where is None or read is None:
        raise BadInput(f"{unnamed}: its terms are chosen from measurements", todo="give --arm and --data")
    arm = read_arm(where)
    known = library.with_unnamed(chosen.unnamed.values())
    return find_unnamed(
        arm, read(arm), names, chosen.texts, library=known, dh=chosen.dh, progress=progress
    )  # fmt: skip


def check_names(library: Library, names: Sequence[str], arm: ArmTable | None) -> None:
    """Every name is an effect of the library, with its constants, at joints that the arm has, or that arms
    usually have if it is not known; unnamed effects are not looked for. BadInput otherwise."""
    named = [name for name in names if name != UNNAMED and not is_unnamed(name)]
    _check_named(library, named)
    if arm is not None:
        for name in names:
            library.check_joints(split_constants(name)[0], arm)
        return
    for name in named:
        if joint := next((x for x in _joints(name) if x > _USUAL_JOINTS), 0):
            raise BadInput(
                f"{name}: the model does not say yet which arm it is for, and few arms have a joint {joint}",
                todo="name the arm table by --arm",
            )


def _joints(text: str) -> list[int]:
    """Joints that a name is at; none if it is at all of them, or at none."""
    inside = split_constants(text)[0].partition("[")[2].rstrip("]")
    return [int(x) for x in inside.split(",") if x]


def _check_named(library: Library, names: Sequence[str]) -> None:
    for text in names:
        name, constants = split_constants(text)
        base, _, joint = name.partition("[")
        if base not in library.effects:
            near = [n for n in library.effects if n.startswith(base[:4])] or list(library.effects)
            raise BadInput(
                f"no effect '{shown(base)}'",
                todo=f"did you mean {', '.join(near[:6])}? `kincal model effects` lists all",
            )
        inside = joint.rstrip("]")
        if joint and not (joint.endswith("]") and all(_JOINT.fullmatch(x) for x in inside.split(","))):
            raise BadInput(
                f"{name!r} does not name joints", todo=f"write {base}[2] for one joint, or {base} for all"
            )
        if any(x > MAX_JOINTS for x in _joints(name)):
            raise BadInput(f"{name!r}: an arm has up to {MAX_JOINTS} joints", todo="they count from 1")
        if joint and library.effects[base].per == "arm":
            raise BadInput(f"{base} concerns the whole arm, no joint of it", todo=f"leave [{inside}] out")
        library.check_constants(base, constants)


@dataclass(frozen=True)
class ForFlight:
    """The term table of a model.

    compared: with which arm table of flight the arm was compared, in words; effects: of the model; left_out:
    those of them that the table lacks; choice: of the effects by measurements, None if none were named.
    """

    image: Image
    compared: str
    arm: ArmTable
    dh: bool
    effects: tuple[Hypothesis, ...]
    left_out: tuple[Hypothesis, ...]
    choice: Choice | None

    def cost(self) -> EffectGain | None:
        """What the effects left out bring on held-out poses; None without effects or data."""
        if not self.left_out or self.choice is None:
            return None
        data, anew = self.choice.data, self.choice.anew
        return cost_without(self.arm, data, self.effects, self.left_out, dh=self.dh, anew=anew)


def for_flight(
    model_path: Path,
    tables_dir: Path,
    effect_files: Sequence[Path] = (),
    arm_path: Path | None = None,
    read: Read | None = None,
    drop: Sequence[str] = (),
) -> ForFlight:
    """The model of a file as a term table for the flight tables of a folder.

    read: measurements for constants that follow from them, None: constants of the last fit; drop: effects to
    leave out. BadInput if the arm is not theirs, or the model too large for flight.
    """
    chosen, library = load_model(model_path, effect_files)
    arm = read_arm(arm_of(chosen, model_path, arm_path))
    refuse_model_of_other_arm(chosen, arm, str(model_path))
    compared = refuse_other_arm(arm, tables_dir)
    data = read(arm) if read else None
    choice = None if data is None else Choice(library, chosen.texts, arm, data, chosen.dh)
    effects = (
        choose_constants(library, chosen.texts, arm, None, dh=chosen.dh, known=chosen.constants)
        if choice is None
        else choice.hypotheses
    )
    left_out = dropped(effects, drop)
    image = term_image(arm, [h for h in effects if h not in left_out], Flown.read(tables_dir), chosen)
    return ForFlight(image, compared, arm, chosen.dh, tuple(effects), tuple(left_out), choice)
