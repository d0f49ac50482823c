"""From fsw/msg/*.lcm: types of the LCM messages for mypy, ground/kincal/link/messages.pyi, and the lists of
channels and of message fields, channels.csv and messages.csv in ground/kincal_shared/schema.

    message_stubs.py [--check]

lcm-gen writes classes without types; these protocols say what is in them. With --check the lists are
compared, and the exit status is 1 if they are not what the messages say."""

from __future__ import annotations

import csv
import io
import re
import sys
from collections.abc import Iterable
from pathlib import Path

from lcm_files import Message, messages

TARGET = Path(__file__).resolve().parent / "kincal" / "link" / "messages.pyi"
SCHEMA = Path(__file__).resolve().parent / "kincal_shared" / "schema"
CHANNEL_COLUMNS = ("name", "type", "sender", "receivers", "rate", "purpose")
FIELD_COLUMNS = ("message", "name", "type", "unit", "meaning", "flight")
HEAD = '''"""Made by ground/message_stubs.py from fsw/msg; do not edit. Types of the LCM messages for mypy."""

from typing import Protocol

class LcmMessage(Protocol):
    """Any message."""

    def encode(self) -> bytes: ...
'''
TYPES = {"boolean": "bool", "string": "str", "byte": "int", "double": "float", "float": "float"}


def class_name(message: str) -> str:
    """ "arm_state_t" -> "ArmState"."""
    return "".join(part.capitalize() for part in message.removesuffix("_t").split("_"))


def python_type(lcm_type: str) -> str:
    """ "double[6][2]" -> "list[list[float]]"; bytes stay bytes."""
    base, *sizes = re.findall(r"\w+", lcm_type)
    if base == "byte" and sizes:
        return "bytes"
    plain = TYPES.get(base, "int" if base.startswith("int") else class_name(base))
    return "list[" * len(sizes) + plain + "]" * len(sizes)


def stub(message: Message) -> str:
    """The protocol of one message."""
    fields = [f"    {field.name}: {python_type(field.type)}" for field in message.fields]
    head = [f"class {class_name(message.name)}(LcmMessage, Protocol):", f'    """{message.name}"""', ""]
    return "\n".join(head + fields)


def _csv(columns: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([columns, *rows])
    return out.getvalue()


def channels() -> str:
    """The list of channels, by name."""
    return _csv(
        CHANNEL_COLUMNS, sorted((name, m.name, *rest) for m in messages() for name, *rest in m.channels)
    )


def fields() -> str:
    """Every field of every message, in the order in which LCM encodes them."""
    return _csv(
        FIELD_COLUMNS,
        (
            (m.name, f.name, f.type, f.unit, f.comment, ", ".join(f.flight))
            for m in messages()
            for f in m.fields
        ),
    )


def main() -> int:
    """Write or check the files; exit status."""
    stubs = "\n\n".join([HEAD.rstrip(), *map(stub, messages())]) + "\n"
    TARGET.write_text(stubs)
    for name, text in (("channels.csv", channels()), ("messages.csv", fields())):
        path = SCHEMA / name
        if "--check" not in sys.argv[1:]:
            path.write_text(text)
        elif path.read_text() != text:
            print(f"{path}: not what fsw/msg says: run make stubs")
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
