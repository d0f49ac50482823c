"""The model file M.toml: which effects are in use, with every change kept as history."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from kincal_shared.errors import BadInput
from kincal_shared.schema.effects import ParameterEntry
from kincal_shared.schema.errors import SchemaError, read_toml, validate
from kincal_shared.schema.model import (
    VERSION,
    DataEntry,
    ExpectedEntry,
    FitEntry,
    FormerEntry,
    FrameEntry,
    ModelEntry,
    SightEntry,
    UnnamedEntry,
    ValueEntry,
)
from kincal_shared.schema.names import effect_of, split_constants, with_constants
from kincal_shared.writing import is_stream, write_file

from ..numerics.types import Array

_HEADER = re.compile(r"^(\[\[?)")  # of a table


@dataclass(frozen=True)
class Change:
    """One entry of the history: what was done, to which effects, and what the list was before."""

    when: str
    action: str
    effects: tuple[str, ...]
    before: tuple[str, ...]


@dataclass(frozen=True)
class ModelFile:
    """Effects in use (in the order they were added), a user's own library files, and the history.

    fixed: constants that fits keep, by effect; those of other effects are chosen by the data.
    values, units, constants, fit: of the last fit, by coefficient and by effect; `uplink` uses the
    constants, exports use all.
    former: the last fit of other effects that a change discarded; `undo` brings it back.
    unnamed: terms of the unnamed effects, by name; those of the history too, so that `undo` finds them.
    content: of the file that it was read from; empty if there was none.
    """

    effects: tuple[str, ...] = ()
    fixed: dict[str, dict[str, float]] = field(default_factory=dict)
    libraries: tuple[str, ...] = ()
    dh: bool = True
    history: tuple[Change, ...] = ()
    arm: str = ""
    values: dict[str, tuple[float, float]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    constants: dict[str, dict[str, float]] = field(default_factory=dict)
    fit: FitEntry | None = None
    former: FormerEntry | None = None
    unnamed: dict[str, UnnamedEntry] = field(default_factory=dict)
    content: bytes = field(default=b"", compare=False, repr=False)

    def with_terms(self, entry: UnnamedEntry) -> ModelFile:
        """The model that knows the terms of an unnamed effect, or knows them anew: a former fit may be of
        other terms then, and is forgotten."""
        other = entry.name in self.unnamed and self.unnamed[entry.name] != entry
        former = None if other else self.former
        return replace(self, unnamed={**self.unnamed, entry.name: entry}, former=former)

    @classmethod
    def of(cls, texts: Iterable[str]) -> ModelFile:
        """A model with these effects, as `add` takes them, and no history."""
        effects, fixed = _effects_of(texts)
        return cls(effects=effects, fixed=fixed)

    @property
    def texts(self) -> tuple[str, ...]:
        """Effects in use with the constants that fits keep, as `add` takes them."""
        return tuple(with_constants(name, self.fixed.get(name, {})) for name in self.effects)

    def add(self, texts: list[str]) -> ModelFile:
        """The model with these effects too. BadInput if one is there already, alone or for all joints."""
        new = [_split(text) for text in texts]
        after = (*self.effects, *(name for name, _ in new))
        for name, _ in new:
            whole = effect_of(name)
            if after.count(name) > 1:
                raise BadInput(
                    f"{name} is already in the model",
                    todo="`kincal model list` names what it has; to choose its constants anew, "
                    "`kincal model remove` it first",
                )
            if whole in after and any(other.startswith(f"{whole}[") for other in after):
                raise BadInput(
                    f"{whole} is the effect at all joints; it cannot stand beside one of them",
                    todo="`kincal model remove` takes one of them out",
                )
        return self._changed("add", tuple(texts), (*self.texts, *texts))

    def remove(self, texts: list[str]) -> ModelFile:
        """The model without these effects, with or without constants. BadInput if one is not in it."""
        names = [_split(text)[0] for text in texts]
        absent = [name for name in names if name not in self.effects]
        if absent:
            there = ", ".join(self.effects) or "no effect"
            raise BadInput(f"{absent[0]} is not in the model; it holds {there}")
        kept = [text for text, name in zip(self.texts, self.effects, strict=True) if name not in names]
        return self._changed("remove", tuple(names), tuple(kept))

    def undo(self) -> ModelFile:
        """Take back the last change that was not itself taken back, with the fit that it discarded if that is
        the former one; the undo is history too."""
        depth = 0
        for change in reversed(self.history):
            if change.action == "undo":
                depth += 1
            elif depth:
                depth -= 1
            else:
                return self._changed("undo", change.effects, change.before)._refitted(self.former)
        raise BadInput("nothing to undo: every change was taken back")

    def _changed(self, action: str, texts: tuple[str, ...], after: tuple[str, ...]) -> ModelFile:
        when = datetime.now(UTC).isoformat(timespec="seconds")
        history = (*self.history, Change(when, action, texts, self.texts))
        effects, fixed = _effects_of(after)
        return replace(
            self, effects=effects, fixed=fixed, history=history, values={}, units={}, constants={}, fit=None,
            former=self._fit_to_keep() or self.former,
        )  # fmt: skip

    def _refitted(self, former: FormerEntry | None) -> ModelFile:
        """The model with a former fit, if that is of its effects."""
        if former is None or tuple(former.effects) != self.texts:
            return self
        model = _with_fit(self, former)
        return replace(model, former=None) if self.former is former else model

    def _fit_to_keep(self) -> FormerEntry | None:
        """The last fit, with the effects that it is of."""
        if self.fit is None:
            return None
        values = [
            ValueEntry(name=name, value=value, std_err=std_err, unit=self.units.get(name, ""))
            for name, (value, std_err) in self.values.items()
        ]
        return FormerEntry(
            effects=list(self.texts), arm=self.arm, value=values, constants=self.constants, fit=self.fit
        )


def _with_fit(model: ModelFile, former: FormerEntry) -> ModelFile:
    """The model with the fit that it had."""
    return replace(
        model, arm=former.arm, fit=former.fit, constants=former.constants, **_coefficients(former.value)
    )


def _coefficients(values: Iterable[ValueEntry]) -> dict[str, Any]:
    """The fields of a model that hold the coefficients of a file."""
    return {
        "values": {v.name: (v.value, v.std_err) for v in values},
        "units": {v.name: v.unit for v in values},
    }


def _split(text: str) -> tuple[str, dict[str, float]]:
    try:
        return split_constants(text)
    except ValueError as error:
        raise BadInput(str(error)) from None


def _effects_of(texts: Iterable[str]) -> tuple[tuple[str, ...], dict[str, dict[str, float]]]:
    """Names, and the constants of those that have some."""
    split = [_split(text) for text in texts]
    return tuple(name for name, _ in split), {name: constants for name, constants in split if constants}


def read_model(path: str | Path, *, must_exist: bool = True) -> ModelFile:
    """Read M.toml. A missing file is an empty model unless must_exist. SchemaError lists what is wrong."""
    path = Path(path)
    if not path.exists():
        if must_exist:
            raise BadInput("no such file", str(path), f"`kincal model add --model {path} EFFECT` makes one")
        return ModelFile()
    content = _content(path)  # before it is parsed: a change in between is noticed, never lost
    entry = _validated(path)
    effects, fixed = _effects_of(entry.effects)
    return ModelFile(
        effects=effects,
        fixed=fixed,
        libraries=tuple(entry.libraries),
        dh=entry.dh,
        history=tuple(Change(h.when, h.action, tuple(h.effects), tuple(h.before)) for h in entry.history),
        arm=entry.arm,
        constants=entry.constants,
        fit=entry.fit,
        former=entry.former,
        unnamed={u.name: u for u in entry.unnamed},
        content=content,
        **_coefficients(entry.value),
    )


def _validated(path: Path) -> ModelEntry:
    """Where only [former] is damaged, the error says that the file is good without."""
    try:
        return validate(ModelEntry, read_toml(path), str(path))
    except SchemaError as error:
        if any(p.path.split(".")[0] != "former" for p in error.problems):
            raise
        todo = "mend it, or delete [former] and the tables in it, which only `kincal model undo` needs"
        raise BadInput(error.what, str(path), todo) from None


def _content(path: Path) -> bytes:
    """Of a file; nothing of what is none, or cannot be read."""
    try:
        return path.read_bytes() if path.is_file() else b""
    except OSError:
        return b""


def change_model(
    path: str | Path, change: Callable[[ModelFile], ModelFile], *, must_exist: bool = True
) -> ModelFile:
    """Read a model file, change it and write it, while other commands that would change it wait. For changes
    that take no time. must_exist: as of `read_model`."""
    with held(path):
        after = change(read_model(path, must_exist=must_exist))
        write_model(path, after)
    return after


def replace_model(path: str | Path, model: ModelFile) -> None:
    """Write a model that took long to compute from what was read of the same file. BadInput if the file was
    changed meanwhile: what the other command wrote stays."""
    path = Path(path)
    with held(path):
        if not is_stream(path) and _content(path) != model.content:
            raise BadInput(
                "another command changed it meanwhile, so nothing was written",
                str(path),
                "run this command again",
            )
        write_model(path, model)


@contextlib.contextmanager
def held(path: str | Path) -> Iterator[None]:
    """Other commands that change this model file wait. The lock is on its folder: the file itself is replaced
    when it is written, and a lock file beside it would stay. File systems without locks have none."""
    place = Path(os.path.realpath(path)).parent
    folder = next(p for p in (place, *place.parents) if p.is_dir())
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield


def write_model(path: str | Path, model: ModelFile) -> None:
    """Write whole or not at all. BadInput if it cannot be written."""
    lines = [
        *_in_use(model), *_unnamed(model), *_history(model), *_of_last_fit(model), *_fit(model.fit),
        *_former(model.former),
    ]  # fmt: skip
    write_file(Path(path), "\n".join(lines) + "\n")


def _in_use(model: ModelFile) -> list[str]:
    arm = [f"arm = {json.dumps(model.arm)}"] if model.arm else []
    return [
        "# KinCal model: DH errors (dh), base and tool as the arm table says, and these effects.",
        f"version = {VERSION}",
        f"dh = {'true' if model.dh else 'false'}",
        f"effects = {_texts(model.texts)}",
        f"libraries = {_texts(model.libraries)}",
        *arm,
    ]


def _unnamed(model: ModelFile) -> list[str]:
    lines = []
    for entry in model.unnamed.values():
        lines += ["", "[[unnamed]]", f"name = {json.dumps(entry.name)}"]
        lines += [line for parameter in entry.parameter for line in _parameter(parameter)]
    return lines


def _parameter(p: ParameterEntry) -> list[str]:
    lines = ["", "[[unnamed.parameter]]"]
    lines += [f"name = {json.dumps(p.name)}", f"unit = {json.dumps(p.unit)}", f"sigma = {float(p.sigma)!r}"]
    for term in p.term:
        keys = term.model_dump(exclude_defaults=True)
        lines += ["[[unnamed.parameter.term]]", *(f"{key} = {json.dumps(x)}" for key, x in keys.items())]
    return lines


def _history(model: ModelFile) -> list[str]:
    lines = []
    for change in model.history:
        lines += [
            "",
            "[[history]]",
            f"when = {json.dumps(change.when)}",
            f"action = {json.dumps(change.action)}",
        ]
        lines += [f"effects = {_texts(change.effects)}", f"before = {_texts(change.before)}"]
    return lines


def _of_last_fit(model: ModelFile) -> list[str]:
    lines = []
    for name, (value, std_err) in model.values.items():
        lines += ["", "[[value]]", f"name = {json.dumps(name)}"]
        lines += [f"value = {float(value)!r}", f"std_err = {float(std_err)!r}"]
        lines += [f"unit = {json.dumps(model.units[name])}"] if model.units.get(name) else []
    for effect, row in model.constants.items():
        lines += ["", f"[constants.{json.dumps(effect)}]"]
        lines += [f"{name} = {float(value)!r}" for name, value in row.items()]
    return lines


def _fit(fit: FitEntry | None) -> list[str]:
    """The table [fit]: plain keys first, as TOML wants it."""
    if fit is None:
        return []
    optional = ("held_mm", "held_mrad", "held_table_mm", "exported_table_mm", "end_s")
    given = {key: value for key in optional if (value := getattr(fit, key)) is not None}
    return [
        "",
        "[fit]",
        *(f"{key} = {json.dumps(getattr(fit, key))}" for key in ("when", "tool_version", "arm_sha256")),
        f"poses = {fit.poses}",
        f"components = {fit.components}",
        f"held = {_texts(fit.held)}",
        *(f"{key} = {value!r}" for key, value in given.items()),
        f"noise_scale = {fit.noise_scale!r}",
        "covariance = [",
        *(f"  [{', '.join(map(repr, row))}]," for row in fit.covariance),
        "]",
        *_frame("base", fit.base),
        *_frame("tool", fit.tool),
        *(line for data in fit.data for line in _data(data)),
        *_table("expected", fit.expected),
        *_table("sight", fit.sight),
        *(["", "[fit.position_change_mm]"] if fit.position_change_mm else []),
        *(f"{json.dumps(name)} = {value!r}" for name, value in fit.position_change_mm.items()),
    ]


def _former(former: FormerEntry | None) -> list[str]:
    """The table [former]: the same tables as of the last fit, inside it."""
    if former is None:
        return []
    model = _with_fit(ModelFile(), former)
    tables = [*_of_last_fit(model), *_fit(model.fit)]
    arm = [f"arm = {json.dumps(former.arm)}"] if former.arm else []
    return ["", "[former]", f"effects = {_texts(former.effects)}", *arm,
            *(_HEADER.sub(r"\1former.", line) for line in tables)]  # fmt: skip


def _frame(name: str, frame: FrameEntry) -> list[str]:
    numbers = (f"{key} = {list(getattr(frame, key))}" for key in ("xyz_m", "quat_wxyz"))
    return ["", f"[fit.{name}]", *numbers]


def _table(name: str, entry: ExpectedEntry | SightEntry | None) -> list[str]:
    keys = {} if entry is None else entry.model_dump(mode="json", exclude_none=True)
    return ["", f"[fit.{name}]", *(f"{key} = {json.dumps(x)}" for key, x in keys.items())] if keys else []


def _data(data: DataEntry) -> list[str]:
    return ["", "[[fit.data]]", f"path = {json.dumps(data.path)}", f"sha256 = {json.dumps(data.sha256)}"]


def _texts(items: Iterable[str]) -> str:
    return "[" + ", ".join(json.dumps(item) for item in items) + "]"


def covariance_of(model: ModelFile) -> Array | None:
    """(k, k) covariance of the coefficients of the last fit, in the order of `model.values`; None if the
    model holds no fit, or not the rows of these coefficients."""
    k, rows = len(model.values), model.fit.covariance if model.fit else []
    if not k or [len(row) for row in rows] != list(range(1, k + 1)):
        return None
    out = np.zeros((k, k))
    for i, row in enumerate(rows):
        out[i, : i + 1] = out[: i + 1, i] = row
    return out
