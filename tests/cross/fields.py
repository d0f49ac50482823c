"""Structs of the core as bytes that do not depend on the CPU: every field in the order of its declaration,
little-endian, enums as 32 bits; no padding, no pointers.

`c_source` writes the C side, a function for each struct that walks its fields with kc_codec.h; `packed` is
the Python side. Both follow cffi's declarations, so that no field is forgotten."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from cffi import FFI

# cffi's name of a C type -> function of kc_codec.h, further arguments, format of struct
NUMBERS = {
    "uint8_t": ("u8", ", 0u, UINT8_MAX", "<B"),
    "uint16_t": ("u16", ", 0u, UINT16_MAX", "<H"),
    "uint32_t": ("u32", ", 0u, UINT32_MAX", "<I"),
    "int32_t": ("i32", ", INT32_MIN, INT32_MAX", "<i"),
    "uint64_t": ("u64", ", 0u, UINT64_MAX", "<Q"),
    "double": ("f64", ", -KC_INF, KC_INF", "<d"),
}


def _fields(ctype: FFI.CType) -> Iterator[tuple[str, FFI.CType]]:
    return ((name, field.type) for name, field in ctype.fields)


def _structs(ctype: FFI.CType, found: dict[str, FFI.CType]) -> None:
    """The struct and those inside it, innermost first."""
    if ctype.kind == "array":
        _structs(ctype.item, found)
    elif ctype.kind == "struct":
        for _, inner in _fields(ctype):
            _structs(inner, found)
        found.setdefault(ctype.cname, ctype)


def _walk(ctype: FFI.CType, at: str, depth: int = 0) -> list[str]:
    """Statements that walk the value at an expression."""
    if ctype.kind == "array":
        i = "ijk"[depth]
        inner = _walk(ctype.item, f"{at}[{i}]", depth + 1)
        head = f"for (uint32_t {i} = 0u; {i} < {ctype.length}u; {i}++) {{"
        return [head, *(f"    {line}" for line in inner), "}"]
    if ctype.kind == "struct":
        return [f"walk_{ctype.cname}(w, &{at});"]
    if ctype.kind == "enum":
        walk = "kc_walk_i32(w, 0u, &number, INT32_MIN, INT32_MAX);"
        return [f"{{ int32_t number = (int32_t){at};", walk, f"{at} = ({ctype.cname})number; }}"]
    name, limits, _ = NUMBERS[ctype.cname]
    return [f"kc_walk_{name}(w, 0u, &{at}{limits});"]


def c_source(ffi: FFI, names: tuple[str, ...]) -> str:
    """Walking functions of the named structs and of those inside them."""
    found: dict[str, FFI.CType] = {}
    for name in names:
        _structs(ffi.typeof(name), found)
    out = ["/* Made by tests/cross/fields.py. */"]
    for name, ctype in found.items():
        out.append(f"static void walk_{name}(kc_walk_t *w, {name} *v)\n{{")
        for field, inner in _fields(ctype):
            out += [f"    {line}" for line in _walk(inner, f"v->{field}")]
        out.append("}")
    return "\n".join(out) + "\n"


def packed(ffi: FFI, value: object, ctype: FFI.CType | None = None) -> bytes:
    """The bytes of a value of the core."""
    ctype = ctype or ffi.typeof(value)
    if ctype.kind == "array":
        return b"".join(packed(ffi, x, ctype.item) for x in value)
    if ctype.kind == "struct":
        return b"".join(packed(ffi, getattr(value, name), inner) for name, inner in _fields(ctype))
    return struct.pack("<i" if ctype.kind == "enum" else NUMBERS[ctype.cname][2], value)
