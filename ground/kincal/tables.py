"""Tables: TOML for people <-> images for flight, through the flight core's own codec.

A TOML source uses the field names of the C struct of its kind (units are in the names), so the
headers in fsw/ say what each value means. Added for people:

* ``kind``, ``title`` and ``[provenance]`` (free text: where numbers come from);
* a number may be written as an expression string such as ``"-pi/2"`` or ``"25*deg"``;
* enumerations by name (``acquisition = "ucb"``);
* ``terms``: a ``[dh]`` block stands for the four DH errors of every joint, and a coefficient with
  ``joints = [...]`` stands for one per joint;
* ``kernel``: a ``[[set]]`` with lists of hyperparameters stands for their whole grid; the spectral
  coefficients are computed when the table is built;
* ``space``: a description of the search, see ``kincal space build``.
"""

from __future__ import annotations

import ast
import functools
import itertools
import math
import operator
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kincal import core
from kincal.errors import KincalError

KINDS = {"arm": 1, "camera": 2, "terms": 3, "kin": 4, "space": 5, "kernel": 6, "config": 7}
KIND_NAMES = {number: name for name, number in KINDS.items()}
CTYPES = {name: f"kc_{name}_t" for name in KINDS}
MAGIC = b"KCT1"
HEADER_BYTES = 16
VERSION = 1

FRAMES = {"base": 0, "tool": 9, "camera": 10, "meas": 11}
# Fields that are enumerations: their names come from the headers.
ENUMS = {
    ("kc_joint_t", "type"): ("kc_joint_type_t", "KC_"),
    ("kc_config_t", "acquisition"): ("kc_acq_t", "KC_ACQ_"),
    ("kc_kernel_t", "arg"): ("kc_kernel_arg_t", "KC_KERNEL_"),
    ("kc_term_t", "comp"): ("kc_comp_t", "KC_"),
    ("kc_basis_t", "fn"): ("kc_fn_t", "KC_FN_"),
    ("kc_basis_t", "var"): ("kc_var_t", "KC_VAR_"),
    ("kc_volume_t", "kind"): ("kc_volume_kind_t", "KC_VOL_"),
}
# struct -> {array field: (its counter, its name in TOML)}
LISTS: dict[str, dict[str, tuple[str, str]]] = {
    "kc_arm_t": {"joint": ("n_joints", "joint")},
    "kc_camera_t": {"tag": ("n_tags", "tag")},
    "kc_terms_t": {"coef": ("n_coef", "coef"), "term": ("n_term", "term")},
    "kc_kin_t": {"value": ("n_coef", "value"), "sigma": ("n_coef", "sigma")},
    "kc_kernel_t": {"hyper": ("n_hyper", "hyper")},
    "kc_hyper_t": {"w": ("n_w", "w")},
    "kc_space_t": {
        "cand": ("n_cand", "cand"),
        "prior": ("n_prior", "prior"),
        "body": ("n_body", "body"),
        "volume": ("n_volume", "volume"),
    },
}
FOR_PEOPLE = {"kind", "title", "provenance"}


@dataclass(frozen=True)
class Image:
    """A table image and what its header says."""

    kind: str
    version: int
    crc: int
    payload_bytes: int
    data: bytes

    @property
    def crc_text(self) -> str:
        return f"{self.crc:08x}"


# --------------------------------------------------------------------------- numbers and names

_OPS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_CONSTANTS = {"pi": math.pi, "deg": math.pi / 180.0, "inf": math.inf}
_CALLS = {"sin": math.sin, "cos": math.cos, "sqrt": math.sqrt}


def number(value: Any, where: str) -> float:
    """A number, or an expression of numbers, pi, deg, sin, cos, sqrt in a string."""
    if isinstance(value, bool):
        return float(value)
    if isinstance(value, (int, float)):
        return float(value)
    if not isinstance(value, str):
        raise KincalError(f"{value!r} is not a number", where)

    def walk(node: ast.AST) -> float:
        if isinstance(node, ast.Expression):
            return walk(node.body)
        if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
            return float(node.value)
        if isinstance(node, ast.Name) and node.id in _CONSTANTS:
            return _CONSTANTS[node.id]
        if isinstance(node, ast.BinOp) and type(node.op) in _OPS:
            return _OPS[type(node.op)](walk(node.left), walk(node.right))
        if isinstance(node, ast.UnaryOp) and type(node.op) in _OPS:
            return _OPS[type(node.op)](walk(node.operand))
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id in _CALLS
            and len(node.args) == 1
        ):
            return _CALLS[node.func.id](walk(node.args[0]))
        raise ValueError(ast.dump(node))

    try:
        return walk(ast.parse(value, mode="eval"))
    except (ValueError, SyntaxError, ZeroDivisionError, OverflowError, RecursionError):
        raise KincalError(
            f"cannot work out {value!r}", where, "use numbers, + - * / **, pi, deg, sin(), cos(), sqrt()"
        ) from None


@functools.cache
def enum_names(ctype: str, prefix: str) -> tuple[str, ...]:
    """Names of an enumeration of the headers, in order, in small letters and without prefix."""
    elements = core.ffi.typeof(ctype).elements
    return tuple(
        elements[i].removeprefix(prefix).lower()
        for i in sorted(elements)
        if not elements[i].endswith("_COUNT")
    )


def names_of_field(struct: str, field: str) -> tuple[str, ...]:
    """Names that a struct field takes, empty if it is a plain number."""
    where = ENUMS.get((struct, field))
    return enum_names(*where) if where else ()


def kind_number(name: str, where: str = "") -> int:
    try:
        return KINDS[name]
    except KeyError:
        raise KincalError(f"unknown table kind {name!r}", where, "kinds are " + " ".join(KINDS)) from None


def unit_of(coef: str) -> str:
    """Unit of a coefficient from its name."""
    if coef.startswith("encoder_gain"):
        return "rad/rad"
    if coef.startswith("joint_compliance"):
        return "rad/(N m)"
    if coef.endswith("_rad"):
        return "rad"
    if coef.endswith("_m"):
        return "m"
    return ""


# --------------------------------------------------------------------------- dict <-> C struct


def _fill_value(ctype: Any, old: Any, value: Any, struct: str, field: str, where: str) -> Any:
    """Python value to put into a struct field of that type; fills arrays and structs in place."""
    if ctype.kind == "primitive":
        names = names_of_field(struct, field)
        if names and isinstance(value, str):
            if value not in names:
                raise KincalError(f"{value!r} is none of {', '.join(names)}", where)
            return names.index(value)
        x = number(value, where)
        if "float" in ctype.cname or "double" in ctype.cname:
            return x
        if not math.isfinite(x) or x != int(x):
            raise KincalError(f"{value!r} must be a whole number", where)
        # whole numbers stay whole: a 64-bit mask does not fit a double
        return int(value) if isinstance(value, int) else int(x)
    if ctype.kind == "struct":
        fill(old, value, where)
        return None
    assert ctype.kind == "array"
    if ctype.item.cname == "char":
        text = str(value).encode("ascii", "replace")
        if len(text) >= ctype.length:
            raise KincalError(f"{value!r} is longer than {ctype.length - 1} characters", where)
        core.ffi.buffer(old)[:] = text.ljust(ctype.length, b"\0")
        return None
    if not isinstance(value, list):
        raise KincalError(f"expected a list, got {value!r}", where)
    if len(value) > ctype.length:
        raise KincalError(f"{len(value)} entries, room for {ctype.length}", where)
    for i, item in enumerate(value):
        new = _fill_value(ctype.item, old[i], item, struct, field, f"{where}[{i}]")
        if new is not None:
            try:
                old[i] = new
            except OverflowError:
                raise KincalError(f"{item!r} does not fit {ctype.item.cname}", f"{where}[{i}]") from None
    return None


def fill(target: Any, doc: Any, where: str = "") -> None:
    """Fill a C struct from a dict with its field names. Every field must be given; none may be
    unknown; counters follow from the lengths of lists."""
    struct = core.ffi.typeof(target)
    if struct.kind == "pointer":
        target, struct = target[0], struct.item
    name = struct.cname
    lists = LISTS.get(name, {})
    counters = {counter for counter, _ in lists.values()}
    if not isinstance(doc, dict):
        raise KincalError(f"expected a block of fields, got {doc!r}", where)
    known = {lists[f][1] if f in lists else f for f, _ in struct.fields if f not in counters}
    given = {key for key in doc if not (where.count(":") == 0 and key in FOR_PEOPLE)}
    for key in sorted(given - known):
        raise KincalError(f"unknown field {key!r}", where or name, f"fields are {', '.join(sorted(known))}")
    for key in sorted(known - given):
        raise KincalError(f"field {key!r} is missing", where or name)
    for field, info in struct.fields:
        if field in counters:
            continue
        key = lists[field][1] if field in lists else field
        here = f"{where}:{key}" if where else key
        value = doc[key]
        if field in lists:
            setattr(target, lists[field][0], len(value))
        old = getattr(target, field) if info.type.kind != "primitive" else None
        new = _fill_value(info.type, old, value, name, field, here)
        if new is not None:
            try:
                setattr(target, field, new)
            except OverflowError:
                raise KincalError(f"{value!r} does not fit {info.type.cname}", here) from None


def to_doc(source: Any) -> Any:
    """The opposite of fill: a dict of plain values."""
    ctype = core.ffi.typeof(source)
    if ctype.kind == "pointer":
        source, ctype = source[0], ctype.item
    name = ctype.cname
    lists = LISTS.get(name, {})
    counters = {counter for counter, _ in lists.values()}
    doc: dict[str, Any] = {}
    for field, info in ctype.fields:
        if field in counters:
            continue
        value = getattr(source, field)
        count = int(getattr(source, lists[field][0])) if field in lists else None
        key = lists[field][1] if field in lists else field
        doc[key] = _plain(info.type, value, name, field, count)
    return doc


def _plain(ctype: Any, value: Any, struct: str, field: str, count: int | None) -> Any:
    if ctype.kind == "primitive":
        names = names_of_field(struct, field)
        if names and 0 <= value < len(names):
            return names[value]
        return value
    if ctype.kind == "struct":
        return to_doc(value)
    if ctype.item.cname == "char":
        return core.ffi.string(value).decode("ascii", "replace")
    if ctype.item.cname in ("uint8_t", "unsigned char") and ctype.length > 1000:
        return core.ffi.buffer(value)[:]  # bit sets stay bytes
    n = ctype.length if count is None else count
    return [_plain(ctype.item, value[i], struct, field, None) for i in range(n)]


# --------------------------------------------------------------------------- the codec


def encode(kind: str, struct: Any) -> Image:
    """Image of a filled C struct."""
    number_ = kind_number(kind)
    need = core.ffi.new("uint32_t *")
    core.lib.kc_tbl_encode(number_, struct, 0, core.ffi.NULL, 0, need)
    buffer = core.ffi.new("uint8_t[]", int(need[0]))
    status = core.lib.kc_tbl_encode(number_, struct, 0, buffer, need[0], need)
    if status != 0:
        raise KincalError(f"the table cannot be written: {core.status_name(status)}", kind)
    return header(bytes(core.ffi.buffer(buffer)), kind)


def header(data: bytes, where: str = "") -> Image:
    """Read the header only."""
    if len(data) < HEADER_BYTES or data[:4] != MAGIC:
        raise KincalError(
            "this is not a table image", where, "images start with KCT1; build one with table build"
        )
    number_ = int.from_bytes(data[4:6], "little")
    if number_ not in KIND_NAMES:
        raise KincalError(f"unknown table kind {number_}", where)
    return Image(
        KIND_NAMES[number_],
        int.from_bytes(data[6:8], "little"),
        int.from_bytes(data[12:16], "little"),
        int.from_bytes(data[8:12], "little"),
        data,
    )


def decode(data: bytes, where: str = "") -> tuple[Image, Any]:
    """Check an image as flight would and return it with its C struct."""
    image = header(data, where)
    struct = core.ffi.new(f"{CTYPES[image.kind]} *")
    events = core.ffi.new("kc_events_t *")
    status = core.lib.kc_tbl_decode(KINDS[image.kind], data, len(data), struct, events)
    if status != 0:
        said = [event_line(e.id, e.index, e.got, e.want) for e in events.e[0 : events.n]]
        raise KincalError(
            f"{image.kind} table refused: {core.status_name(status)}"
            + "".join(f"\n    {line}" for line in said),
            where,
        )
    return image, struct


def event_line(event_id: int, index: int, got: float, want: float) -> str:
    """NAME: text of an event with its values filled in; the dictionary is the core's."""
    name = core.ffi.string(core.lib.kc_event_name(event_id)).decode()
    text = core.ffi.string(core.lib.kc_event_text(event_id)).decode()
    crc = "CRC" in text or "correction {got}" in text or name in ("COR_ROLLBACK",)

    def show(x: float) -> str:
        if crc and float(x).is_integer() and abs(x) > 4096.0:
            return f"{int(x) & 0xFFFFFFFF:08x}"
        return f"{x:g}"

    return f"{name}: " + (
        text.replace("{got}", show(got)).replace("{want}", show(want)).replace("{index}", str(index))
    )


# --------------------------------------------------------------------------- TOML sources


def read_toml(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except FileNotFoundError:
        raise KincalError("no such file", str(path)) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise KincalError(f"not valid TOML: {error}", str(path)) from None


def build(source: Path, tables: Path | None = None) -> Image:
    """Build one image from its TOML source. A space description needs `tables`, the directory with the
    arm and camera images it is built for."""
    doc = read_toml(source)
    where = str(source)
    kind = doc.get("kind", "")
    kind_number(kind, where)
    if kind == "space":
        from kincal import space  # the search imports this module

        return space.build(space.read_description(source), tables or source.parent.parent / "bin").image
    expand = {"terms": expand_terms, "kernel": expand_kernel, "arm": expand_arm, "kin": expand_kin}.get(
        kind, lambda d, _w: d
    )
    struct = core.ffi.new(f"{CTYPES[kind]} *")
    body = {key: value for key, value in doc.items() if key not in FOR_PEOPLE}
    fill(struct, expand(body, where), where)
    image = encode(kind, struct)
    decode(image.data, where)  # what flight would refuse is refused here
    return image


def load(path: Path, tables: Path | None = None) -> tuple[Image, Any]:
    """Image and struct of a .tbl or .toml file."""
    if path.suffix == ".toml":
        return decode(build(path, tables).data, str(path))
    try:
        data = path.read_bytes()
    except OSError as error:
        raise KincalError(f"cannot read: {error.strerror}", str(path)) from None
    return decode(data, str(path))


def build_order(sources: list[Path]) -> list[Path]:
    """Spaces last: they need the arm and the camera."""
    return sorted(sources, key=lambda p: (read_toml(p).get("kind") == "space", p.name))


def expand_arm(doc: dict[str, Any], _where: str) -> dict[str, Any]:
    """Joints may leave out mass_kg and com_m (has_mass follows) and carry a name."""
    out = dict(doc)
    out["joint"] = []
    for joint in doc.get("joint", []):
        entry = {key: value for key, value in joint.items() if key != "joint_name"}
        entry["has_mass"] = int("mass_kg" in joint)
        entry.setdefault("mass_kg", 0.0)
        entry.setdefault("com_m", [0.0, 0.0, 0.0])
        entry.setdefault("gear_ratio", 0.0)
        out["joint"].append(entry)
    return out


def expand_kin(doc: dict[str, Any], _where: str) -> dict[str, Any]:
    """A nominal table may give n_coef instead of lists of zeros."""
    out = dict(doc)
    n = out.pop("n_coef", None)
    if n is not None:
        out = {"value": [0.0] * int(n), "sigma": [0.0] * int(n)} | out
    return out


_DH = (("phi_rad", "rz", -1), ("alpha_rad", "rx", 0), ("a_m", "tx", 0), ("d_m", "tz", -1))
_COEF_KEYS = ("name", "lb", "ub", "prior_sigma", "scale", "enabled")


def expand_terms(doc: dict[str, Any], where: str) -> dict[str, Any]:
    """[dh] and per-joint coefficients written out; terms numbered by coefficient."""
    unknown = set(doc) - {"dh", "coef"}
    if unknown:
        raise KincalError(
            f"unknown field {sorted(unknown)[0]!r}", where, "a terms table has [dh] and [[coef]]"
        )
    coefs: list[dict[str, Any]] = []
    terms: list[dict[str, Any]] = []
    for entry in itertools.chain(_dh_entries(doc.get("dh"), where), doc.get("coef", [])):
        for j in entry.get("joints", [None]):
            here = f"{where}:coef {entry.get('name')}"
            coefs.append({key: _required(entry, key, here) for key in _COEF_KEYS})
            coefs[-1]["name"] = str(entry["name"]).replace("{j}", str(j))
            coefs[-1]["enabled"] = int(bool(entry["enabled"]))
            for term in _required(entry, "term", here):
                terms.append(_expand_term(term, len(coefs) - 1, j, here))
    return {"coef": coefs, "term": terms}


def _required(entry: dict[str, Any], key: str, where: str) -> Any:
    try:
        return entry[key]
    except KeyError:
        raise KincalError(f"field {key!r} is missing", where) from None


def _dh_entries(dh: dict[str, Any] | None, where: str) -> Iterator[dict[str, Any]]:
    if dh is None:
        return
    here = f"{where}:dh"
    n = int(_required(dh, "joints", here))
    for j in range(1, n + 1):
        for name, comp, shift in _DH:
            bound = _required(_required(dh, "bound", here), name, here)
            if isinstance(bound, list):  # one for each joint
                if len(bound) != n:
                    raise KincalError(f"{len(bound)} bounds for {n} joints", f"{here}.bound.{name}")
                bound = bound[j - 1]
            bound = number(bound, here)
            yield {
                "name": f"J{j}.{name}",
                "lb": -bound,
                "ub": bound,
                "prior_sigma": _required(dh, "prior_sigma", here)[name],
                "scale": _required(dh, "scale", here)[name],
                "enabled": dh.get("enabled", True),
                "term": [{"frame": j + shift, "comp": comp}],
            }


def _expand_term(term: dict[str, Any], coef: int, j: int | None, where: str) -> dict[str, Any]:
    frame = term.get("frame")
    if frame == "before joint" and j is not None:
        frame = j - 1
    elif frame == "after joint" and j is not None:
        frame = j
    elif isinstance(frame, str):
        if frame not in FRAMES:
            raise KincalError(
                f"unknown frame {frame!r}",
                where,
                "0..n, " + ", ".join(FRAMES) + ", or with joints = [...] 'before joint', 'after joint'",
            )
        frame = FRAMES[frame]
    one = {"fn": "lin", "var": "one", "index": 0, "c0": 0.0, "c1": 1.0}
    bases = [one | {k: (j if v == "joint" else v) for k, v in b.items()} for b in term.get("basis", [])]
    bases += [one] * (2 - len(bases))
    return {
        "coef": coef,
        "frame": frame,
        "comp": term.get("comp"),
        "gain": term.get("gain", 1.0),
        "basis": bases,
    }


def expand_kernel(doc: dict[str, Any], where: str) -> dict[str, Any]:
    """Every [[set]] becomes the grid of its lists; spectral tables are computed here."""
    from kincal import kernels  # numbers by another module; only needed to build

    hyper = []
    for entry in doc.get("set", []):
        grid = {
            key: entry[key] if isinstance(entry.get(key), list) else [_required(entry, key, f"{where}:set")]
            for key in ("nu", "kappa", "beta_m", "sigma_s")
        }
        for nu, kappa, beta_m, sigma_s in itertools.product(*grid.values()):
            try:
                spectrum = kernels.spectral_table(
                    doc.get("arg", "so3"), number(kappa, where), number(nu, where)
                )
            except ValueError as error:
                raise KincalError(str(error), where) from None
            hyper.append(
                {
                    "sigma_s": sigma_s,
                    "beta_m": beta_m,
                    "kappa": kappa,
                    "nu": nu,
                    "w": [float(w) for w in spectrum.w],
                    "trunc_err": float(spectrum.trunc_err),
                }
            )
    return {key: value for key, value in doc.items() if key != "set"} | {"hyper": hyper}


# --------------------------------------------------------------------------- differences


def flatten(doc: Any, path: str = "") -> dict[str, Any]:
    """path -> value; list entries that carry a name go by it."""
    if isinstance(doc, dict):
        out: dict[str, Any] = {}
        for key, value in doc.items():
            out |= flatten(value, f"{path}.{key}" if path else key)
        return out
    if isinstance(doc, list):
        out = {}
        for i, value in enumerate(doc):
            tag = value["name"] if isinstance(value, dict) and value.get("name") else str(i)
            out |= flatten(value, f"{path}[{tag}]")
        return out
    if isinstance(doc, bytes):
        return {path: f"{sum(b.bit_count() for b in doc)} bits set, {len(doc)} bytes, hash {hash_bytes(doc)}"}
    return {path: doc}


def hash_bytes(data: bytes) -> str:
    import zlib

    return f"{zlib.crc32(data):08x}"


@dataclass(frozen=True)
class Change:
    path: str
    a: Any
    b: Any


def diff(a: Path, b: Path) -> tuple[Image, Image, list[Change]]:
    """Every field that differs between two tables of one kind."""
    image_a, struct_a = load(a)
    image_b, struct_b = load(b)
    if image_a.kind != image_b.kind:
        raise KincalError(f"{image_a.kind} and {image_b.kind} tables cannot be compared", f"{a} {b}")
    flat_a, flat_b = flatten(to_doc(struct_a)), flatten(to_doc(struct_b))
    keys = list(flat_a) + [key for key in flat_b if key not in flat_a]
    return (
        image_a,
        image_b,
        [Change(key, flat_a.get(key), flat_b.get(key)) for key in keys if flat_a.get(key) != flat_b.get(key)],
    )
