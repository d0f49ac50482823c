"""Write the types of the flight core for mypy: structs, functions and constants of its public headers.

    stubs.py [--check]        ground/kincal/flight/headers.pyi and ground/kincal_shared/schema/acquisitions.py
                              from build/kincal*_cdef.h, variables.csv beside it from fsw/model/kc_variables.h

One protocol for each struct, with its fields; one for each build of the core, with its functions and
constants; `new` knows which struct it makes. Only type checkers read that file. The names of acquisitions
and variables are there for schemas of files, which do without the core.
"""

from __future__ import annotations

import argparse
import ast
import csv
import io
import sys
from keyword import iskeyword
from pathlib import Path

from cdef import preprocess
from cffi import FFI

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "ground" / "kincal" / "flight" / "headers.pyi"
SCHEMA = ROOT / "ground" / "kincal_shared" / "schema"
# name of the protocol -> (library, declarations)
BUILDS = {
    "FlightCore": ("libkincal.so", "kincal_cdef.h"),
    "GroundCore": ("libkincal_ground.so", "kincal_ground_cdef.h"),
}
HEAD = '''"""Made by ground/stubs.py from the public headers; do not edit. Types of the core for mypy."""

from collections.abc import Iterable, Iterator
from typing import Literal, Protocol, TypeAlias, TypeVar, overload

from cffi import FFI

CData: TypeAlias = FFI.CData
_T = TypeVar("_T")

class Array(Protocol[_T]):
    """Array field of a struct."""

    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[_T]: ...
    @overload
    def __getitem__(self, index: int) -> _T: ...
    @overload
    def __getitem__(self, index: slice) -> Array[_T]: ...
    @overload
    def __setitem__(self, index: int, value: _T) -> None: ...
    @overload
    def __setitem__(self, index: slice, value: Iterable[_T]) -> None: ...
'''


def class_name(ctype: str) -> str:
    """kc_arm_t -> KcArm."""
    words = ctype.removeprefix("struct ").removesuffix("_t").split("_")
    return "".join(word.capitalize() for word in words)


def field_type(ctype: FFI.CType) -> str:
    """Python type of a struct field."""
    if ctype.kind == "primitive":
        return {"double": "float", "float": "float", "_Bool": "bool"}.get(ctype.cname, "int")
    if ctype.kind == "enum":
        return "int"
    if ctype.kind in ("struct", "union"):
        return class_name(ctype.cname) if ctype.cname.endswith("_t") else "CData"
    if ctype.kind == "array" and ctype.item.cname == "char":
        return "CData | bytes"  # written as bytes, read through Library.text
    if ctype.kind == "array":
        return f"Array[{field_type(ctype.item)}]"
    return "CData"


def argument_type(ctype: FFI.CType) -> str:
    """Python type of a function argument."""
    if ctype.kind == "pointer" and ctype.item.kind == "struct" and ctype.item.cname.endswith("_t"):
        return f"{class_name(ctype.item.cname)} | CData"
    if ctype.kind == "pointer" and ctype.item.kind == "void":
        return "object"
    if ctype.kind == "pointer":
        return "CData | bytes" if ctype.item.cname in ("char", "uint8_t") else "CData"
    return field_type(ctype)


def result_type(ctype: FFI.CType) -> str:
    """Type annotation of what a C function returns."""
    return "None" if ctype.kind == "void" else field_type(ctype)


def struct_class(ctype: FFI.CType) -> list[str]:
    """Protocol of a struct; a pointer to it has the same attributes. Nothing is known of an opaque one."""
    lines = [f"class {class_name(ctype.cname)}(Protocol):", f'    """{ctype.cname}"""', ""]
    lines += [
        f"    {name}: {field_type(info.type)}"
        for name, info in ctype.fields or []
        if name and not iskeyword(name)
    ]
    return lines


def structs(ffi: FFI) -> dict[str, FFI.CType]:
    """Structs and unions of the declarations by name, whose size is known."""
    types = map(ffi.typeof, ffi.list_types()[0])
    return {ctype.cname: ctype for ctype in types if ctype.kind in ("struct", "union")}


def core_class(name: str, ffi: FFI, lib: object) -> list[str]:
    """Protocol of one build: its functions and whole-number constants."""
    found = {key: getattr(lib, key) for key in dir(lib)}
    lines = [f"class {name}(Protocol):"]
    lines += [f"    {key}: int" for key, value in found.items() if isinstance(value, int)]
    for key, value in found.items():
        function = ffi.typeof(value) if isinstance(value, ffi.CData) else None
        if function and function.kind == "function":
            arguments = "".join(f", _{i}: {argument_type(a)}" for i, a in enumerate(function.args))
            lines.append(f"    def {key}(self{arguments}, /) -> {result_type(function.result)}: ...")
    return lines


def stub_text() -> str:
    """The whole file."""
    parts, found = [HEAD.rstrip().splitlines()], {}
    cores = []
    for name, (library, declarations) in BUILDS.items():
        text = (ROOT / "build" / declarations).read_text()
        ffi = FFI()
        ffi.cdef(text)
        cores.append(core_class(name, ffi, ffi.dlopen(str(ROOT / "build" / library))))
        found |= structs(ffi)
    parts += [struct_class(ctype) for _, ctype in sorted(found.items())]
    parts += cores
    new = ["class New(Protocol):", '    """Makes a zeroed struct, by the name of its type."""', ""]
    for name in sorted(name for name, ctype in found.items() if ctype.fields is not None):
        new += [
            "    @overload",
            f'    def __call__(self, ctype: Literal["{name}"], /) -> {class_name(name)}: ...',
        ]
    parts.append(new)
    return "\n\n".join("\n".join(lines) for lines in parts) + "\n"


def acquisitions_text() -> str:
    """Names of kc_acq_t as a type, in the order of their numbers."""
    ffi = FFI()
    ffi.cdef((ROOT / "build" / BUILDS["FlightCore"][1]).read_text())
    numbers = ffi.typeof("kc_acq_t").relements
    known = sorted((n, name) for name, n in numbers.items() if name != "KC_ACQ_COUNT")
    names = ", ".join(f'"{name.removeprefix("KC_ACQ_").lower()}"' for _, name in known)
    return (
        '"""Made by ground/stubs.py from fsw/design/kc_acquire.h; do not edit: the acquisitions."""\n\n'
        "from typing import Literal\n\n"
        f"Acquisition = Literal[{names}]\n"
    )


def variables_text() -> str:
    """Variables of a basis as CSV, in the order of their numbers."""
    listed = preprocess(
        '#include "kc_variables.h"\n'
        "#define ROW(number, NAME, index, from, name, unit, meaning, range, value) \\\n"
        "    (number, #NAME, #index, #from, name, unit, meaning),\n"
        "rows = [KC_VAR_LIST(ROW)]",
        [ROOT / "fsw" / "model"],
    )
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(("name", "flight", "index", "source", "unit", "about"))
    for _, flight, index, source, name, unit, about in sorted(
        ast.literal_eval(listed.partition("rows =")[2].strip())
    ):
        rows.writerow((name, flight.lower(), index.lower(), source.lower(), unit, about))
    return out.getvalue()


def main() -> int:
    """Write or check the stubs of the headers; exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="compare acquisitions and variables")
    check = parser.parse_args().check
    OUT.write_text(stub_text())
    for path, text in (
        (SCHEMA / "acquisitions.py", acquisitions_text()),
        (SCHEMA / "variables.csv", variables_text()),
    ):
        if path.exists() and path.read_text() == text:
            continue  # as old as it is: what is made from it is made again when it is newer
        if check:
            print(f"{path.relative_to(ROOT)}: out of date; run `make stubs`")
            return 1
        path.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
