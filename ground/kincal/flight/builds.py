"""The two builds of the flight core and what their headers say.

    library("flight")   what flies, with flight's limits: tables, motion, estimator, all of fsw/
    library("ground")   arm model and terms alone, for arms and models bigger than flight carries, with the
                        loops over poses of ground/native

Both are found next to their declarations (cffi reads the preprocessed headers): in this package's folder
`_core/`, then in the folder that $KINCAL_CORE names, then in the `build/` folder of the source tree.
Numbers, enumerations and struct layouts come from there and are written nowhere else.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import redirect_stdout, suppress
from functools import cache
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, cast, overload

import _cffi_backend
import numpy as np
from numpy.typing import ArrayLike, NDArray

from kincal_shared.errors import KincalError

if TYPE_CHECKING:
    from cffi import FFI
    from typing_extensions import Buffer

    from .headers import CData, FlightCore, GroundCore, New

Floats: TypeAlias = NDArray[np.float64]
Struct = TypeVar("Struct")
Build: TypeAlias = Literal["flight", "ground"]
# build -> (library, declarations)
FILES: dict[Build, tuple[str, str]] = {
    "flight": ("libkincal.so", "kincal_cdef.h"),
    "ground": ("libkincal_ground.so", "kincal_ground_cdef.h"),
}


def folders() -> list[Path]:
    """Where the libraries are looked for, in this order."""
    package = Path(__file__).resolve().parents[1]
    named = os.environ.get("KINCAL_CORE")
    return [package / "_core", *([Path(named)] if named else []), package.parent.parent / "build"]


def library_file(build: Build) -> Path:
    """Path of a build's shared library. KincalError if it was not built."""
    shared, declarations = FILES[build]
    for folder in folders():
        if (folder / shared).is_file() and (folder / declarations).is_file():
            return folder / shared
    looked = ", ".join(str(f) for f in folders())
    raise KincalError(f"the library {shared} was not found", f"looked in {looked}", "run `make core`")


class CoreError(KincalError):
    """The flight core refused; `.status` is its kc_status_t."""

    def __init__(self, status: int, what: str) -> None:
        super().__init__(f"{what}: {status_name(status)}")
        self.status = status


def _declared(declarations: str, kept: Path) -> FFI:
    """cffi's view of the declarations. Parsing them takes a third of a second, so the result is kept in a
    file, and used as long as declarations and cffi are the same. If the folder cannot be written, every start
    parses."""
    made_from = hashlib.sha256(f"{_cffi_backend.__version__}\n{declarations}".encode()).hexdigest()
    try:
        head, _, code = kept.read_text().partition("\n")
    except (OSError, UnicodeDecodeError):
        head = code = ""
    if head == f"# {made_from}":
        names: dict[str, Any] = {}
        exec(code, names)  # noqa: S102  (from the folder that the library is loaded from)
        return cast("FFI", names["ffi"])
    from cffi import FFI

    ffi = FFI()
    ffi.cdef(declarations)
    own = kept.with_suffix(f".{os.getpid()}")
    with suppress(OSError), redirect_stdout(StringIO()):  # cffi prints what it does
        ffi.set_source(kept.stem, None)
        ffi.emit_python_code(str(own))
        own.write_text(f"# {made_from}\n{own.read_text()}")
        own.replace(kept)
    return ffi


class _Library:
    """One build: its foreign functions, and helpers around them. Get one with `library`."""

    def __init__(self, build: Build) -> None:
        path = library_file(build)
        self.build: Build = build
        header = path.parent / FILES[build][1]
        declarations = header.read_text()
        self.ffi = _declared(declarations, header.with_suffix(".parsed"))
        self._decimals = dict(re.findall(r"^/\* (\w+) = (\S+) \*/$", declarations, flags=re.M))
        self._lib = self.ffi.dlopen(str(path))
        self._dtypes: dict[str, np.dtype[Any]] = {}

    # -- numbers and names

    def constant(self, name: str) -> int:
        """A whole-number macro or an enumerator of the headers, e.g. "KC_COEF_MAX"."""
        return int(getattr(self._lib, name))

    def decimal(self, name: str) -> float:
        """A macro of the headers that is no whole number, e.g. "KC_HUB_BOUND"."""
        return float(self._decimals[name])

    def enum(self, ctype: str, prefix: str) -> dict[str, int]:
        """Enumeration of the headers as {name: number}, in order of the numbers; names without the prefix
        and in capitals, without the COUNT that closes some: enum("kc_state_t", "KC_ST_")["IDLE"]."""
        found: Mapping[int, str] = self.ffi.typeof(ctype).elements
        return {
            found[number].removeprefix(prefix): number
            for number in sorted(found)
            if found[number] != f"{prefix}COUNT"
        }

    # -- structs and arrays

    @property
    def new(self) -> New:
        """Make a zeroed struct: new("kc_arm_t"). It lives as long as it is referred to."""
        return cast("New", self._new)

    def _new(self, ctype: str) -> object:
        return self.ffi.new(f"{ctype} *")

    def copy(self, struct: Struct) -> Struct:
        """A copy of a struct."""
        ctype = self.ffi.typeof(cast("CData", struct))
        item = ctype.item if ctype.kind == "pointer" else ctype
        out = self.ffi.new(f"{item.cname} *")
        self.ffi.memmove(out, self.address(struct), self.ffi.sizeof(item.cname))
        return cast(Struct, out)

    def address(self, struct: object) -> CData:
        """Pointer to a struct; a pointer stays what it is."""
        data = cast("CData", struct)
        return data if self.ffi.typeof(data).kind == "pointer" else self.ffi.addressof(data)

    def text(self, field: object) -> str:
        """String of a char array, or of a `const char *` result."""
        raw = self.ffi.string(cast("CData", field))
        return raw.decode("ascii", "replace") if isinstance(raw, bytes) else raw

    def dtype(self, ctype: str) -> np.dtype[Any]:
        """numpy's layout of a struct, so that an array of structs is filled and read by columns."""
        if ctype not in self._dtypes:
            self._dtypes[ctype] = np.dtype(self._layout(self.ffi.typeof(ctype)))
        return self._dtypes[ctype]

    def _layout(self, ctype: FFI.CType) -> Any:
        if ctype.kind == "array":
            return (self._layout(ctype.item), (ctype.length,))
        if ctype.kind == "struct":
            return {
                "names": [name for name, _ in ctype.fields],
                "formats": [self._layout(info.type) for _, info in ctype.fields],
                "offsets": [info.offset for _, info in ctype.fields],
                "itemsize": self.ffi.sizeof(ctype.cname),
            }
        if ctype.cname == "char":
            return "S1"
        if ctype.kind == "enum" or ctype.kind == "primitive":
            kind = "f" if ctype.cname in ("double", "float") else "u" if ctype.cname[0] in "u_" else "i"
            return f"{kind}{self.ffi.sizeof(ctype.cname)}"
        raise TypeError(f"{ctype.cname} has no numpy layout")

    def pointer(self, array: NDArray[Any] | None, ctype: str = "double") -> CData:
        """Pointer to an array's own memory, which must be contiguous and stay alive; NULL for None."""
        if array is None:
            return self.ffi.NULL
        if not array.flags.c_contiguous:
            raise ValueError("the array is not contiguous")
        # not by its memoryview, which numpy would describe: of structs that takes as long as a computation
        return self.ffi.from_buffer(f"{ctype} *", cast("Buffer", array))

    def array(self, field: object, *shape: int) -> Floats:
        """View without a copy on an array field of doubles, or on its start in the given shape."""
        data: Floats = np.frombuffer(memoryview(self.ffi.buffer(cast("CData", field))), dtype=np.float64)
        return data[: int(np.prod(shape))].reshape(shape) if shape else data

    def rows(self, field: Sequence[Any] | object, count: int) -> NDArray[Any]:
        """The first `count` entries of an array of structs as a numpy array of records, without a copy:
        rows(space.cand, space.n_cand)["q_seed"]."""
        data = cast("CData", field)
        item = self.ffi.typeof(data).item
        whole: NDArray[Any] = np.frombuffer(memoryview(self.ffi.buffer(data)), dtype=self.dtype(item.cname))
        return whole[:count]

    def set_fields(self, struct: Struct, values: Mapping[str, object]) -> Struct:
        """Set fields of a struct by name: dicts go into structs, sequences into the start of arrays,
        strings into char arrays. ValueError if an array is too short. Returns the struct."""
        for name, value in values.items():
            self._set_field(struct, name, value)
        return struct

    def _set_field(self, struct: object, name: str, value: object) -> None:
        old = getattr(struct, name)
        if isinstance(value, (str, bytes)):
            setattr(struct, name, value.encode() if isinstance(value, str) else value)
        elif isinstance(value, Mapping):
            self.set_fields(old, value)
        elif isinstance(value, Iterable):
            items = np.asarray(value).tolist() if isinstance(value, np.ndarray) else list(value)
            if len(items) > len(old):
                raise ValueError(f"{name}: {len(items)} values, room for {len(old)}")
            for i, item in enumerate(items):
                if isinstance(item, Mapping):
                    self.set_fields(old[i], item)
                else:
                    old[i] = item
        else:
            setattr(struct, name, value)


class FlightLibrary(_Library):
    """What flies."""

    @property
    def lib(self) -> FlightCore:
        """The functions and constants of fsw/."""
        return cast("FlightCore", self._lib)


class GroundLibrary(_Library):
    """Arm model and terms with the ground's limits."""

    @property
    def lib(self) -> GroundCore:
        """The functions and constants of fsw/math, fsw/model and ground/native."""
        return cast("GroundCore", self._lib)


@overload
def library(build: Literal["flight"]) -> FlightLibrary: ...
@overload
def library(build: Literal["ground"]) -> GroundLibrary: ...
@cache
def library(build: Build) -> FlightLibrary | GroundLibrary:
    """One of the two builds, loaded at the first call. KincalError if it was not built."""
    return FlightLibrary("flight") if build == "flight" else GroundLibrary("ground")


def status_name(status: int) -> str:
    """ "KC_OK", "KC_ERR_ARG" ..."""
    flight = library("flight")
    return flight.text(flight.lib.kc_status_name(status))


def check(status: int, what: str) -> None:
    """Raise CoreError unless the status is KC_OK."""
    if status != 0:
        raise CoreError(status, what)


def doubles(values: ArrayLike, shape: tuple[int, ...] | None = None) -> Floats:
    """Contiguous array of doubles; ValueError if it is not of the shape."""
    array = np.ascontiguousarray(values, dtype=float)
    if shape is not None and array.shape != shape:
        raise ValueError(f"expected shape {shape}, got {array.shape}")
    return array
