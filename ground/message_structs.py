"""From fsw/msg/*.lcm: flight's plain structs of the messages, and the functions that copy between them and
those of LCM.

    message_structs.py FOLDER [MESSAGES]        FOLDER/ROOM/kc_*.h, FOLDER/lcm/kc_wire.h and kc_wire.c

CMake runs it when it configures. What LCM cannot say stands in comments of the message files; their form is
in docs/DEVELOPING.md, "Message files". Standard library only; a file whose text is the same is left alone."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from math import isqrt
from pathlib import Path

from lcm_files import FOLDER, Enum, Field, Message, messages

BY_HAND = "by hand"
WORDS = ("unsigned", "flag", "real", "triangle", "gathered", "bytes", "edge", "received")
WITH_VALUE = ("as", "input")
LIMITS = "kc_limits.h"
MADE = "/* Made by ground/message_structs.py from fsw/msg; do not edit. */"


@dataclass(frozen=True)
class Member:
    """A field as flight holds it. path: in the struct; length: expression in C, empty of a single value."""

    field: Field
    kind: frozenset[str]
    path: str
    length: str
    number: str

    @property
    def wire(self) -> str:
        """LCM's type in C."""
        base = self.field.type.partition("[")[0]
        return "uint8_t" if base == "byte" else base

    @property
    def count(self) -> int:
        """Number of values on the wire; 0 of a single value."""
        sizes = re.findall(r"\[(\d+)\]", self.field.type)
        return int(sizes[0]) if sizes else 0

    @property
    def type(self) -> str:
        """Its type in flight."""
        if "real" in self.kind:
            return "double"
        if "flag" in self.kind:
            return "uint8_t"
        return f"u{self.wire}" if "unsigned" in self.kind and self.wire.startswith("int") else self.wire

    @property
    def declared(self) -> bool:
        """Whether it is a member of the struct itself, not of a struct or array in it."""
        return self.path.isidentifier()


@dataclass(frozen=True)
class Struct:
    """A message in flight. header: "room/kc_x.h", or BY_HAND; needs: headers; also: further members, as
    (declaration, comment)."""

    message: Message
    header: str
    needs: tuple[str, ...]
    also: tuple[tuple[str, str], ...]
    input: str
    members: tuple[Member, ...]

    @property
    def name(self) -> str:
        """Name in C."""
        return f"kc_{self.message.name}"

    def channels(self, sent: bool) -> list[str]:
        """Names of the channels on which flight sends it, or takes it."""
        return [
            name
            for name, sender, receivers, *_ in self.message.channels
            if (sender == "flight" if sent else "flight" in receivers.split(", "))
        ]


def wrong(message: Message, what: str) -> SystemExit:
    """A file that breaks the rules."""
    return SystemExit(f'fsw/msg/{message.name}.lcm: {what}: see "Message files" in docs/DEVELOPING.md')


def member(message: Message, field: Field) -> Member:
    """What the comment behind a field says. SystemExit for a word that has no meaning."""
    kind, path, length, number = set(), field.name, "", ""
    sizes = re.findall(r"\[(\w+)\]", field.type)
    if len(sizes) > 1 or not all(size.isdigit() for size in sizes):
        raise wrong(message, f"{field.name}: flight takes single values and arrays of one fixed length")
    if sizes:
        length = sizes[0] + "u"
    for part in field.flight:
        word, _, value = part.partition(" ")
        if part in WORDS:
            kind.add(part)
        elif word == "as" and value:
            path = value
        elif word == "input" and re.fullmatch(r"\d+ [A-Z_]+", value):
            number = value
        elif sizes and (named := re.fullmatch(r"\[(.+)\]", part)):
            length = named[1]
        else:
            raise wrong(message, f"{field.name}: {part!r} after `// flight:` means nothing")
    if "triangle" in kind:
        side = (isqrt(8 * int(sizes[0]) + 1) - 1) // 2
        length = f"{side * side}u"
    return Member(field, frozenset(kind), path, length, number)


def struct(message: Message) -> Struct | None:
    """A message as flight holds it, None if flight does not."""
    lines = message.flight
    where = next((text for key, text in lines if key == "Flight"), "")
    if not where:
        return None
    header, _, needs = where.partition(", with ")
    also = []
    for key, text in lines:
        if key not in ("Flight", "Flight also", "Flight input"):
            raise wrong(message, f"`// {key}:` means nothing")
        if key == "Flight also":
            declaration, _, comment = text.partition(": ")
            also.append((declaration, comment))
    return Struct(
        message,
        header,
        tuple(needs.split(", ")) if needs else (),
        tuple(also),
        next((text for key, text in lines if key == "Flight input"), ""),
        tuple(member(message, field) for field in message.fields),
    )


# ---- headers


def declaration(s: Struct) -> str:
    """The struct in C."""
    out = [f"/* fsw/msg/{s.message.name}.lcm */", "typedef struct {"]
    for m in s.members:
        if m.declared and ("edge" not in m.kind or s.channels(sent=False)):
            out.append(f"    {m.type} {m.path}{f'[{m.length}]' if m.length else ''};")
    out += [f"    {text};" + (f" /* {comment} */" if comment else "") for text, comment in s.also]
    return "\n".join([*out, f"}} {s.name};"])


def enumeration(e: Enum, message: Message) -> str:
    """Constants of a message in C."""
    rows = ",\n".join(f"    {e.prefix}{name} = {value}" for name, value in e.constants)
    return f"/* fsw/msg/{message.name}.lcm */\ntypedef enum {{\n{rows}\n}} {e.type};"


def inputs(structs: list[Struct]) -> str:
    """Numbers and names of the fields of inputs, for events. SystemExit if two numbers are the same."""
    rows, taken = [], set()
    for s in structs:
        for m in s.members:
            if m.number:
                first, name = m.number.split()
                # lengths are those of the wire but for a triangle, which comes unpacked
                count = int(m.length[:-1]) if "triangle" in m.kind else max(m.count, 1)
                numbers = set(range(int(first), int(first) + count))
                if taken & numbers:
                    raise wrong(s.message, f"{m.field.name}: another field has number {min(taken & numbers)}")
                taken |= numbers
                rows.append(f'    X({first}, {count}u, {name}, "{s.input} {m.field.name}")')
    head = '/* X(first, count, NAME, "name"): kc_input_fields.h. */\n#define KC_INPUT_MESSAGE_LIST(X)'
    return " \\\n".join([head, *rows])


def header(path: str, structs: list[Struct]) -> str:
    """A header with the structs of its messages."""
    name = path.rpartition("/")[2]
    guard = name.upper().replace(".", "_")
    needs = sorted({LIMITS, *(need for s in structs for need in s.needs)} - {name})
    parts = [
        MADE,
        f"#ifndef {guard}\n#define {guard}\n\n#include <stdint.h>\n",
        "".join(f'#include "{need}"\n' for need in needs),
        "\n\n".join(
            text
            for s in structs
            for text in (*(enumeration(e, s.message) for e in s.message.enums), declaration(s))
        )
        + "\n",
    ]
    if any(m.number for s in structs for m in s.members):
        parts.append(inputs(structs) + "\n")
    return "\n".join([*parts, "#endif"]) + "\n"


# ---- copying

WIRE_HEAD = """/* Between LCM messages and flight's structs: units and bits unchanged. Nothing is checked
 * here; the component does that. To flight: what is gathered keeps what `to` holds. From flight: t_us is
 * mission time. */"""
HELPERS = """/* LCM has no unsigned types: bits are kept. */
#define COPY(to, from)                                                            \\
    do {                                                                          \\
        _Static_assert(sizeof(to) == sizeof(from), "same size on both sides");    \\
        _Static_assert(IS_REAL((to)[0]) == IS_REAL((from)[0]), "whole or real");  \\
        memcpy(&(to), &(from), sizeof(to));                                       \\
    } while (0)
#define IS_REAL(x) _Generic((x), float: 1, double: 1, default: 0)

static void unpack(const double *packed, double *matrix, uint32_t n)
{
    uint32_t k = 0u;
    for (uint32_t i = 0u; i < n; i++) {
        for (uint32_t j = i; j < n; j++, k++) { matrix[n * i + j] = matrix[n * j + i] = packed[k]; }
    }
}

static void pack(const double *matrix, double *packed, uint32_t n)
{
    uint32_t k = 0u;
    for (uint32_t i = 0u; i < n; i++) {
        for (uint32_t j = i; j < n; j++) { packed[k++] = matrix[n * i + j]; }
    }
}

static void to_bytes(const int64_t *numbers, uint8_t *bytes, uint32_t n)
{
    for (uint32_t i = 0u; i < n; i++) {
        bytes[i] = (uint8_t)((uint64_t)numbers[i / 8u] >> (8u * (i % 8u)));
    }
}"""


def _side(m: Member) -> str:
    return f"{isqrt(int(m.length[:-1]))}u"


def _of_length(name: str, length: str) -> str:
    return f'_Static_assert(sizeof({name}) / sizeof({name}[0]) == {length}, "same length on both sides");'


def _each(m: Member, at: str, body: str) -> str:
    return f"{_of_length(at, f'{m.count}u')}\n    for (uint32_t i = 0u; i < {m.count}u; i++) {{ {body} }}"


def taken(m: Member) -> str:
    """Statement that copies a field to flight."""
    to, wire = f"to->{m.path}", f"from->{m.field.name}"
    if "bytes" in m.kind:
        return f"to_bytes({wire}, {to}, (uint32_t)sizeof {to});"
    if "triangle" in m.kind:
        return f"{_of_length(to, m.length)}\n    unpack({wire}, {to}, {_side(m)});"
    if "gathered" in m.kind:
        return f"{to} |= {wire};"
    if "flag" in m.kind:
        return f"{to} = {wire} != 0;"
    if "real" in m.kind:
        return _each(m, to, f"{to}[i] = (double){wire}[i];")
    if m.count:
        return f"COPY({to}, {wire});"
    return f"{to} = {f'({m.type})' if m.type != m.wire else ''}{wire};"


def sent(m: Member) -> str:
    """Statement that copies a field from flight."""
    wire, at = f"to->{m.field.name}", f"from->{m.path}"
    if "edge" in m.kind:
        return f"{wire} = {m.field.name};"
    if "received" in m.kind:
        return f"memset(&{wire}, 0, sizeof {wire});"
    if "triangle" in m.kind:
        return f"{_of_length(at, m.length)}\n    pack({at}, {wire}, {_side(m)});"
    if "real" in m.kind:
        return _each(m, at, f"{wire}[i] = ({m.wire}){at}[i];")
    if m.count:
        return f"COPY({wire}, {at});"
    return f"{wire} = {f'({m.wire})' if m.type != m.wire else ''}{at};"


def function(s: Struct, channel: str, copy: Callable[[Member], str]) -> tuple[str, str]:
    """Head and body of the function of a channel."""
    name = "kc_wire_" + channel.removeprefix("KC_").lower()
    wire = f"kcm_{s.message.name}"
    if copy is taken:
        filled = {m.path.partition(".")[0] for m in s.members}
        further = [text.split()[-1] for text, _ in s.also]
        more = [f"to->{name} = 0u;" for name in further if name not in filled]
        return f"void {name}(const {wire} *from, {s.name} *to)", _body([*map(taken, s.members), *more])
    given = "".join(f", {m.wire} {m.field.name}" for m in s.members if "edge" in m.kind)
    unused = [] if given else ["(void)t_us; /* it has a time of its own */"]
    head = f"void {name}(const {s.name} *from{given or ', int64_t t_us'}, {wire} *to)"
    return head, _body([*unused, *map(sent, s.members)])


def _body(statements: list[str]) -> str:
    return "\n".join(["{", *(f"    {statement}" for statement in statements), "}"])


def wire(structs: list[Struct]) -> tuple[str, str]:
    """kc_wire.h and kc_wire.c."""
    functions = [
        function(s, channel, copy)
        for s in structs
        for copy, out in ((taken, False), (sent, True))
        for channel in s.channels(sent=out)
    ]
    headers = {s.header.rpartition("/")[2] for s in structs if s.header != BY_HAND}
    needs = sorted({*headers, *(need for s in structs if s.header == BY_HAND for need in s.needs)})
    includes = "".join(f'#include "{name}"\n' for name in [*needs, "kcm.h"])
    top = f"{MADE}\n{WIRE_HEAD}\n#ifndef KC_WIRE_H\n#define KC_WIRE_H\n\n#include <stdint.h>\n\n{includes}\n"
    source = "\n\n".join(f"{head}\n{body}" for head, body in functions)
    return (
        top + "".join(f"{head};\n" for head, _ in functions) + "\n#endif\n",
        f'{MADE}\n#include "kc_wire.h"\n\n#include <string.h>\n\n'
        f"{HELPERS if functions else ''}\n\n{source}\n",
    )


def made(found: list[Message]) -> dict[str, str]:
    """Texts of all files, by path."""
    structs = [s for s in map(struct, found) if s is not None]
    names = sorted({s.header for s in structs} - {BY_HAND})
    texts = {name: header(name, [s for s in structs if s.header == name]) for name in names}
    texts["lcm/kc_wire.h"], texts["lcm/kc_wire.c"] = wire(structs)
    return texts


def main() -> int:
    """Write the files; exit status."""
    if len(sys.argv) not in (2, 3):
        print(__doc__)
        return 2
    out, source = Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) == 3 else FOLDER
    texts = made(messages(source))
    for path in sorted(out.rglob("*.[ch]")):
        if path.relative_to(out).as_posix() not in texts:
            path.unlink()
    for name, text in texts.items():
        path = out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
