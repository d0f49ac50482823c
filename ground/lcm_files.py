"""Message files, fsw/msg/*.lcm, as we write them: comments before what they speak of, and in comments of a
fixed form what LCM cannot say (docs/DEVELOPING.md, "Message files"). Standard library only: the build reads
them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).resolve().parent.parent / "fsw/msg"

UNITS = (
    ("_m_s2", "m/s^2"),
    ("_rad_s", "rad/s"),
    ("_rad", "rad"),
    ("_m", "m"),
    ("_us", "us"),
    ("_px", "px"),
    ("_c", "deg C"),
    ("_kg", "kg"),
    ("_bytes", "bytes"),
    ("_j", "J"),
)
# Fields whose unit depends on the joint type.
JOINT_UNIT = {
    "q_rad": "rad (m, prismatic)",
    "q_cmd_rad": "rad (m, prismatic)",
    "dq_rad_s": "rad/s (m/s, prismatic)",
    "q_true_rad": "rad (m, prismatic)",
    "mon_bias": "rad (m, prismatic)",
    "mon_sigma": "rad (m, prismatic)",
}
# What a message's comment begins with, once for each channel: name, sender, receivers, rate, what it carries.
CHANNEL = re.compile(r"Channel (KC_\w+): (.+?) -> (.+?); (.+?); (.+?)\.(?: +|$)")


@dataclass(frozen=True)
class Field:
    """A field of a message. flight: what stands behind it after `// flight:`, part by part."""

    name: str
    type: str
    comment: str
    flight: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """Unit by the end of the name; empty if it has none."""
        if self.name in JOINT_UNIT:
            return JOINT_UNIT[self.name]
        name = re.sub(r"_wxyz$", "", self.name)
        return next((unit for suffix, unit in UNITS if name.endswith(suffix)), "")


@dataclass(frozen=True)
class Enum:
    """Constants that flight has as an enumeration. prefix: of their names there; constants: (name, value)."""

    type: str
    prefix: str
    constants: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class Message:
    """A message type. flight: lines of its comment that begin with "Flight", as (key, text)."""

    name: str
    comment: str
    fields: tuple[Field, ...]
    constants: tuple[tuple[str, int], ...]
    enums: tuple[Enum, ...]
    channels: tuple[tuple[str, ...], ...]
    flight: tuple[tuple[str, str], ...]


def _enum(path: Path, text: str, constants: list[tuple[str, int]]) -> Enum:
    type_, _, prefix = text.partition(" ")
    if not re.fullmatch(r"kc_\w+_t", type_) or not re.fullmatch(r"KC_[A-Z_]*", prefix):
        raise SystemExit(
            f"{path}: {text!r} after `// flight:` means nothing; behind constants `kc_x_t KC_X_`: "
            'see "Message files" in docs/DEVELOPING.md'
        )
    return Enum(type_, prefix, tuple(constants))


def parse(path: Path) -> Message:
    """A .lcm file. SystemExit for what cannot be read."""
    fields: list[Field] = []
    constants: list[tuple[str, int]] = []
    enums: list[Enum] = []
    flight: list[tuple[str, str]] = []
    about, comment, statement = "", [], ""
    for line in path.read_text("utf-8").splitlines():
        line = line.strip()
        if found := re.fullmatch(r"// (Flight(?: \w+)?): (.+)", line):
            flight.append((found[1], found[2]))
        elif line.startswith("//"):
            comment.append(line.removeprefix("//").strip())
        elif line.startswith("struct"):
            about, comment = " ".join(comment), []
        elif line in ("{", "}", "") or line.startswith("package"):
            comment = [] if not line else comment
        else:
            line, _, behind = (part.strip() for part in line.partition("// flight:"))
            statement += " " + line
            if not statement.endswith(";"):
                continue
            if "const" in statement:
                found = [(n, int(v)) for n, v in re.findall(r"(\w+)\s*=\s*(-?\d+)", statement)]
                constants += found
                if behind:
                    enums.append(_enum(path, behind, found))
            elif found := re.fullmatch(r"\s*(\w+)\s+(\w+)((?:\[\w+\])*);", statement):
                parts = tuple(re.split(r",\s*", behind)) if behind else ()
                fields.append(Field(found[2], found[1] + found[3], " ".join(comment), parts))
            else:
                raise SystemExit(f"{path}: cannot read {statement!r}")
            comment, statement = [], ""
    channels = CHANNEL.findall(about)
    if not channels:
        raise SystemExit(f"{path}: no `// Channel KC_...: sender -> receivers; rate; what it carries.`")
    return Message(
        path.stem,
        CHANNEL.sub("", about).strip(),
        tuple(fields),
        tuple(constants),
        tuple(enums),
        tuple(channels),
        tuple(flight),
    )


def messages(folder: Path = FOLDER) -> list[Message]:
    """All message types, by name."""
    return [parse(p) for p in sorted(folder.glob("*.lcm"))]
