"""The model file M.toml: which effects are in use, with every change kept as history."""

from __future__ import annotations

import json
import os
import tempfile
import tomllib
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

from kincal.errors import BadInput

VERSION = 1


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

    values, constants: of the last fit, by coefficient and by effect; `uplink` uses the constants.
    """

    effects: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()
    dh: bool = True
    history: tuple[Change, ...] = ()
    arm: str = ""
    values: dict[str, tuple[float, float]] = field(default_factory=dict)
    constants: dict[str, dict[str, float]] = field(default_factory=dict)

    def add(self, names: list[str]) -> ModelFile:
        after = (*self.effects, *names)
        for name in names:
            whole = name.partition("[")[0]
            if after.count(name) > 1:
                raise BadInput(f"{name} is already in the model")
            if whole in after and any(other.startswith(f"{whole}[") for other in after):
                raise BadInput(f"{whole} is the effect at all joints; it cannot stand beside one of them")
        return self._changed("add", tuple(names), after)

    def remove(self, names: list[str]) -> ModelFile:
        absent = [name for name in names if name not in self.effects]
        if absent:
            there = ", ".join(self.effects) or "no effect"
            raise BadInput(f"{absent[0]} is not in the model; it holds {there}")
        return self._changed("remove", tuple(names), tuple(e for e in self.effects if e not in names))

    def undo(self) -> ModelFile:
        """Take back the last change that was not itself taken back; the undo is history too."""
        depth = 0
        for change in reversed(self.history):
            if change.action == "undo":
                depth += 1
            elif depth:
                depth -= 1
            else:
                return self._changed("undo", change.effects, change.before)
        raise BadInput("nothing to undo: the history is empty")

    def _changed(self, action: str, names: tuple[str, ...], effects: tuple[str, ...]) -> ModelFile:
        when = datetime.now(UTC).isoformat(timespec="seconds")
        history = (*self.history, Change(when, action, names, self.effects))
        return replace(self, effects=effects, history=history, values={}, constants={})


def read_model(path: str | Path, *, must_exist: bool = True) -> ModelFile:
    """Read M.toml. A missing file is an empty model unless must_exist. BadInput names key and reason."""
    path = Path(path)
    if not path.exists():
        if must_exist:
            raise BadInput(f"{path}: no such file; `kincal model add --model {path} EFFECT` makes one")
        return ModelFile()
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: not valid TOML: {error}") from None
    if table.get("version", VERSION) != VERSION:
        raise BadInput(f"{path}: version {table['version']!r}; this kincal reads version {VERSION}")
    unknown = set(table) - {"version", "dh", "effects", "libraries", "history", "arm", "value", "constants"}
    if unknown:
        raise BadInput(f"{path}: unknown key {sorted(unknown)[0]!r}; known: effects, libraries, dh, arm")
    for key in ("effects", "libraries"):
        value = table.get(key, [])
        if not isinstance(value, list) or not all(isinstance(x, str) for x in value):
            raise BadInput(f"{path}: {key} is {value!r}, a list of texts is needed")
    effects = table.get("effects", [])
    if len(set(effects)) < len(effects):
        raise BadInput(f"{path}: effects names one effect twice")
    try:
        history = tuple(
            Change(h["when"], h["action"], tuple(h["effects"]), tuple(h["before"]))
            for h in table.get("history", [])
        )
        values = {v["name"]: (float(v["value"]), float(v["std_err"])) for v in table.get("value", [])}
        constants = {
            effect: {name: float(value) for name, value in row.items()}
            for effect, row in table.get("constants", {}).items()
        }
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise BadInput(f"{path}: a [[history]], [[value]] or [constants] entry is broken: {error}") from None
    return ModelFile(
        effects=tuple(effects),
        libraries=tuple(table.get("libraries", [])),
        dh=bool(table.get("dh", True)),
        history=history,
        arm=str(table.get("arm", "")),
        values=values,
        constants=constants,
    )


def write_model(path: str | Path, model: ModelFile) -> None:
    """Write whole or not at all (new file, then rename)."""
    path = Path(path)
    lines = [
        "# KinCal model: DH errors (dh), base and tool as the arm table says, and these effects.",
        f"version = {VERSION}",
        f"dh = {'true' if model.dh else 'false'}",
        f"effects = {_texts(model.effects)}",
        f"libraries = {_texts(model.libraries)}",
    ]
    if model.arm:
        lines.append(f"arm = {json.dumps(model.arm)}")
    for change in model.history:
        lines += [
            "",
            "[[history]]",
            f"when = {json.dumps(change.when)}",
            f"action = {json.dumps(change.action)}",
            f"effects = {_texts(change.effects)}",
            f"before = {_texts(change.before)}",
        ]
    for name, (value, std_err) in model.values.items():
        lines += [
            "",
            "[[value]]",
            f"name = {json.dumps(name)}",
            f"value = {float(value)!r}",
            f"std_err = {float(std_err)!r}",
        ]
    for effect, row in model.constants.items():
        lines += ["", f"[constants.{json.dumps(effect)}]"]
        lines += [f"{name} = {float(value)!r}" for name, value in row.items()]
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(
        "w", dir=path.parent, prefix=path.name, suffix=".new", delete=False, encoding="utf-8"
    ) as file:
        file.write("\n".join(lines) + "\n")
    os.replace(file.name, path)


def _texts(items) -> str:
    return "[" + ", ".join(json.dumps(item) for item in items) + "]"
