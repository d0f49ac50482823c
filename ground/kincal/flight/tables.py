"""Table images: the codec of the flight core, and its structs as plain dicts.

Field names are those of the C structs (units are in them), so the headers say what each value means. Fields
that are enumerations take the names of the headers in small letters.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast, overload

from cffi import FFI

from kincal_shared.errors import BadInput

from .builds import library, status_name
from .events import event_line

if TYPE_CHECKING:
    from .headers import CData, KcArm, KcCamera, KcConfig, KcKernel, KcKin, KcSpace, KcTerms

# The struct of a table. `decode` learns which one from the header, the caller of `decode_as` knows it.
Table: TypeAlias = "KcArm | KcCamera | KcTerms | KcKin | KcSpace | KcKernel | KcConfig"
Number: TypeAlias = Callable[[object, str], float]

MAGIC = b"KCT1"
# Fields that hold an enumerator; C has them as uint8_t. (struct, field) -> (enumeration, prefix)
ENUMS = {
    ("kc_joint_t", "type"): ("kc_joint_type_t", "KC_"),
    ("kc_config_t", "acquisition"): ("kc_acq_t", "KC_ACQ_"),
    ("kc_config_t", "frame"): ("kc_right_in_t", "KC_RIGHT_IN_"),
    ("kc_config_t", "initial_design"): ("kc_initial_t", "KC_INITIAL_"),
    ("kc_config_t", "rate_measure"): ("kc_acq_t", "KC_ACQ_"),
    ("kc_config_t", "rate_cost"): ("kc_cost_t", "KC_COST_"),
    ("kc_kernel_t", "arg"): ("kc_kernel_arg_t", "KC_KERNEL_"),
    ("kc_term_t", "comp"): ("kc_comp_t", "KC_"),
    ("kc_basis_t", "fn"): ("kc_fn_t", "KC_FN_"),
    ("kc_basis_t", "var"): ("kc_var_t", "KC_VAR_"),
    ("kc_volume_t", "kind"): ("kc_volume_kind_t", "KC_VOL_"),
}
# struct -> {array field: its counter}
LISTS: dict[str, dict[str, str]] = {
    "kc_arm_t": {"joint": "n_joints"},
    "kc_camera_t": {"tag": "n_tags"},
    "kc_terms_t": {"coef": "n_coef", "term": "n_term"},
    "kc_kin_t": {"value": "n_coef", "sigma": "n_coef"},
    "kc_kernel_t": {"hyper": "n_hyper"},
    "kc_hyper_t": {"w": "n_w"},
    "kc_space_t": {"cand": "n_cand", "initial": "n_initial", "body": "n_body", "volume": "n_volume"},
}
_BIT_SET_BYTES = 1000  # longer arrays of bytes are bit sets, not lists of numbers


@dataclass(frozen=True)
class Image:
    """A table image and what its header says."""

    kind: str
    version: int
    crc: int
    data: bytes

    @property
    def crc_text(self) -> str:
        """Eight hex digits, as people compare them."""
        return f"{self.crc:08x}"


# --------------------------------------------------------------------------- kinds and names


@cache
def kinds() -> dict[str, int]:
    """Table kinds by name: {"arm": 1 ...}."""
    found = library("flight").enum("kc_tbl_kind_t", "KC_TBL_")
    return {name.lower(): number for name, number in found.items()}


def kind_number(name: str, where: str = "") -> int:
    """Number of a table kind. BadInput if there is none of that name."""
    try:
        return kinds()[name]
    except KeyError:
        raise BadInput(f"unknown table kind {name!r}", where, "kinds are " + " ".join(kinds())) from None


def kind_name(number: int, where: str = "") -> str:
    """Name of a table kind. BadInput if there is none of that number."""
    for name, known in kinds().items():
        if known == number:
            return name
    raise BadInput(f"unknown table kind {number}", where)


def new(kind: str, where: str = "") -> Table:
    """A zeroed struct of a table kind."""
    kind_number(kind, where)
    return cast("Table", library("flight").ffi.new(f"kc_{kind}_t *"))


@cache
def names_of_field(struct: str, field: str) -> tuple[str, ...]:
    """Names that a struct field takes, by number; empty if it is a plain number."""
    if (struct, field) not in ENUMS:
        return ()
    return tuple(name.lower() for name in library("flight").enum(*ENUMS[struct, field]))


# --------------------------------------------------------------------------- dict <-> struct


def plain_number(value: object, where: str) -> float:
    """A number as it is. BadInput for anything else."""
    if isinstance(value, (bool, int, float)):
        return float(value)
    raise BadInput(f"{value!r} is not a number", where)


def _opened(struct: object) -> tuple[CData, FFI.CType]:
    """A struct and its type, also from a pointer to it."""
    data = cast("CData", struct)
    ctype = library("flight").ffi.typeof(data)
    return (data[0], ctype.item) if ctype.kind == "pointer" else (data, ctype)


def fill(target: object, doc: object, where: str = "", *, number: Number = plain_number) -> None:
    """Fill a struct from a dict with its field names. Every field must be given; none may be unknown;
    counters follow from the lengths of lists. number: reads values that may be more than a number."""
    opened, struct = _opened(target)
    lists = LISTS.get(struct.cname, {})
    known = {field for field, _ in struct.fields if field not in lists.values()}
    if not isinstance(doc, dict):
        raise BadInput(f"expected a block of fields, got {doc!r}", where)
    for key in sorted(doc.keys() - known):
        todo = f"fields are {', '.join(sorted(known))}"
        raise BadInput(f"unknown field {key!r}", where or struct.cname, todo)
    for key in sorted(known - doc.keys()):
        raise BadInput(f"field {key!r} is missing", where or struct.cname)
    for field, info in struct.fields:
        if field not in known:
            continue
        here = f"{where}:{field}" if where else field
        _fill_field(opened, info.type, (struct.cname, field), doc[field], here, number)
        if field in lists:
            setattr(opened, lists[field], len(doc[field]))


def _fill_field(
    target: CData, ctype: FFI.CType, name: tuple[str, str], value: object, where: str, number: Number
) -> None:
    field = name[1]
    if ctype.kind == "primitive":
        try:
            setattr(target, field, _primitive(ctype, name, value, where, number))
        except OverflowError:
            raise BadInput(f"{value!r} does not fit {ctype.cname}", where) from None
    elif ctype.kind == "struct":
        fill(getattr(target, field), value, where, number=number)
    elif ctype.item.cname == "char":
        _fill_text(getattr(target, field), str(value), ctype.length, where)
    else:
        _fill_array(getattr(target, field), ctype, name, value, where, number)


def _primitive(
    ctype: FFI.CType, name: tuple[str, str], value: object, where: str, number: Number
) -> float | int:
    names = names_of_field(*name)
    if names and isinstance(value, str):
        if value not in names:
            raise BadInput(f"{value!r} is none of {', '.join(names)}", where)
        return names.index(value)
    if isinstance(value, int) and ctype.cname not in ("double", "float"):
        return value  # whole numbers stay whole: a 64-bit mask does not fit a double
    x = number(value, where)
    if ctype.cname in ("double", "float"):
        return x
    if not math.isfinite(x) or x != int(x):
        raise BadInput(f"{value!r} must be a whole number", where)
    return int(x)


def _fill_text(target: CData, text: str, room: int, where: str) -> None:
    raw = text.encode("ascii", "replace")
    if len(raw) >= room:
        raise BadInput(f"{text!r} is longer than {room - 1} characters", where)
    library("flight").ffi.buffer(target)[:] = raw.ljust(room, b"\0")


def _fill_array(
    target: CData, ctype: FFI.CType, name: tuple[str, str], value: object, where: str, number: Number
) -> None:
    if not isinstance(value, list):
        raise BadInput(f"expected a list, got {value!r}", where)
    if len(value) > ctype.length:
        raise BadInput(f"{len(value)} entries, room for {ctype.length}", where)
    for i, item in enumerate(value):
        here = f"{where}[{i}]"
        if ctype.item.kind == "struct":
            fill(target[i], item, here, number=number)
            continue
        try:
            target[i] = _primitive(ctype.item, name, item, here, number)
        except OverflowError:
            raise BadInput(f"{item!r} does not fit {ctype.item.cname}", here) from None


def to_doc(source: object) -> dict[str, Any]:
    """The opposite of fill: a dict of plain values."""
    opened, ctype = _opened(source)
    lists = LISTS.get(ctype.cname, {})
    doc: dict[str, Any] = {}
    for field, info in ctype.fields:
        if field in lists.values():
            continue
        count = int(getattr(opened, lists[field])) if field in lists else None
        doc[field] = _plain(info.type, getattr(opened, field), (ctype.cname, field), count)
    return doc


def _plain(ctype: FFI.CType, value: Any, name: tuple[str, str], count: int | None) -> Any:
    flight = library("flight")
    if ctype.kind == "primitive":
        names = names_of_field(*name)
        return names[value] if names and 0 <= value < len(names) else value
    if ctype.kind == "struct":
        return to_doc(value)
    if ctype.item.cname == "char":
        return flight.text(value)
    if ctype.item.cname in ("uint8_t", "unsigned char") and ctype.length > _BIT_SET_BYTES:
        return cast(bytes, flight.ffi.buffer(value)[:])
    return [_plain(ctype.item, value[i], name, None) for i in range(ctype.length if count is None else count)]


# --------------------------------------------------------------------------- the codec


def encode(kind: str, struct: object) -> Image:
    """Image of a filled struct. BadInput if a count in it is impossible."""
    flight, number = library("flight"), kind_number(kind)
    need = flight.ffi.new("uint32_t *")
    flight.lib.kc_tbl_encode(number, struct, 0, flight.ffi.NULL, 0, need)
    buffer = flight.ffi.new("uint8_t[]", int(need[0]))
    status = flight.lib.kc_tbl_encode(number, struct, 0, buffer, need[0], need)
    if status != 0:
        raise BadInput(f"the table cannot be written: {status_name(status)}", kind)
    return header(bytes(flight.ffi.buffer(buffer)), kind)


def header(data: bytes, where: str = "") -> Image:
    """Read the header only. BadInput if it is none."""
    if len(data) < library("flight").lib.KC_TBL_HDR_BYTES or data[:4] != MAGIC:
        raise BadInput(
            "this is not a table image", where, "images start with KCT1; build one with table build"
        )
    kind, version, crc = (
        int.from_bytes(data[low:high], "little") for low, high in ((4, 6), (6, 8), (12, 16))
    )
    return Image(kind_name(kind, where), version, crc, data)


def decode(data: bytes, where: str = "") -> tuple[Image, Table]:
    """Check an image as flight would and return it with its struct. BadInput says what flight refuses."""
    flight, image = library("flight"), header(data, where)
    struct, events = new(image.kind), flight.new("kc_events_t")
    status = flight.lib.kc_tbl_decode(kind_number(image.kind), data, len(data), struct, events)
    if status != 0:
        why = [event_line(e.id, e.index, e.got, e.want) for e in events.e[0 : events.n]]
        refused = f"{image.kind} table refused: {status_name(status)}"
        said, there = int.from_bytes(data[8:12], "little"), len(data) - flight.lib.KC_TBL_HDR_BYTES
        if said != there:
            raise BadInput(
                f"{refused}\n    its header says {said} bytes of contents, the file has {there}",
                where,
                "it was cut off, or more was written into it: copy or build it again",
            )
        raise BadInput(
            refused + "".join(f"\n    {line}" for line in why),
            where,
            f"docs/TABLES.md has the fields of {image.kind.upper()} by their numbers, with their limits"
            if any("field" in line for line in why)
            else "",
        )
    return image, struct


@overload
def decode_as(kind: Literal["arm"], data: bytes, where: str = "") -> tuple[Image, KcArm]: ...
@overload
def decode_as(kind: Literal["camera"], data: bytes, where: str = "") -> tuple[Image, KcCamera]: ...
@overload
def decode_as(kind: Literal["terms"], data: bytes, where: str = "") -> tuple[Image, KcTerms]: ...
@overload
def decode_as(kind: Literal["kin"], data: bytes, where: str = "") -> tuple[Image, KcKin]: ...
@overload
def decode_as(kind: Literal["space"], data: bytes, where: str = "") -> tuple[Image, KcSpace]: ...
@overload
def decode_as(kind: Literal["kernel"], data: bytes, where: str = "") -> tuple[Image, KcKernel]: ...
@overload
def decode_as(kind: Literal["config"], data: bytes, where: str = "") -> tuple[Image, KcConfig]: ...
def decode_as(kind: str, data: bytes, where: str = "") -> tuple[Image, Any]:
    """As decode, for an image that has to be of a kind. BadInput if it is of another one."""
    image, struct = decode(data, where)
    if image.kind != kind:
        raise BadInput(f"this is a {image.kind} table, a {kind} table is needed", where)
    return image, struct
