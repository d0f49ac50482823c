"""From fsw/msg/*.lcm: types of the LCM messages for mypy, ground/kincal/link/messages.pyi, and the list of
channels, ground/kincal_shared/schema/channels.csv.

    message_stubs.py [--check]

lcm-gen writes classes without types; these protocols say what is in them. With --check the list is compared,
and the exit status is 1 if it is not what the messages say."""

from __future__ import annotations

import csv
import io
import re
import sys
from pathlib import Path

from gen_docs import Message, messages

TARGET = Path(__file__).resolve().parent / "kincal" / "link" / "messages.pyi"
CHANNELS = Path(__file__).resolve().parent / "kincal_shared" / "schema" / "channels.csv"
COLUMNS = ("name", "type", "sender", "receivers", "rate", "purpose")
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


def channels() -> str:
    """The list of channels, by name."""
    rows = sorted((name, m.name, *rest) for m in messages() for name, *rest in m.channels)
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([COLUMNS, *rows])
    return out.getvalue()


def main() -> int:
    """Write or check the files; exit status."""
    stubs = "\n\n".join([HEAD.rstrip(), *map(stub, messages())]) + "\n"
    TARGET.write_text(stubs)
    if "--check" not in sys.argv[1:]:
        CHANNELS.write_text(channels())
    elif CHANNELS.read_text() != channels():
        print(f"{CHANNELS}: not what fsw/msg says: run make stubs")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
