"""Tables: TOML for people -> images for flight, and what differs between two tables.

A source (tables/src/*.toml, models in kincal_shared.schema.tables) uses the field names of the C struct of
its kind, so the headers in fsw/ define each value. For people, some of it is shorter: a [dh] block stands for
the four DH errors of every joint, a coefficient with `joints = [...]` for one per joint, a kernel [[set]]
with lists for their whole grid; the spectral coefficients of the kernel are computed when the table is built.
Search spaces are built by kincal.space.
"""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, cast

from kincal.flight import library
from kincal.flight.bounds import Flown
from kincal.flight.kernel import spectral_table
from kincal.flight.tables import Image, decode, decode_as, encode, fill, new, to_doc
from kincal_shared.errors import BadInput
from kincal_shared.schema.dh import DH_ERRORS
from kincal_shared.schema.errors import read_toml, validate
from kincal_shared.schema.names import VARIABLES
from kincal_shared.schema.tables import (
    SOURCES,
    ArmSource,
    CoefEntry,
    DhBlock,
    KernelSource,
    KinSource,
    Source,
    TermsSource,
)
from kincal_shared.schema.terms import ONE, Basis, TermEntry, basis_text, place_text

if TYPE_CHECKING:
    from kincal.flight.headers import KcSpace, KcTerms
    from kincal.flight.tables import Table

# A table as a dict with the field names of its struct.
Doc: TypeAlias = dict[str, Any]
SourceT = TypeVar("SourceT", bound=Source)
_FOR_PEOPLE = {"kind", "title", "provenance"}


# --------------------------------------------------------------------------- building


def source_kind(source: Path) -> str:
    """Kind of table that a TOML source is for, "space" among them. BadInput names the possible kinds."""
    kind = read_toml(source).get("kind")
    kinds = (*SOURCES, "space")
    if kind not in kinds:
        todo = "write " + " or ".join(f'kind = "{name}"' for name in kinds)
        raise BadInput(
            "kind: is missing" if kind is None else f"kind: {kind!r} is no kind of table", str(source), todo
        )
    return str(kind)


def build(source: Path) -> Image:
    """Image of a TOML source. SchemaError lists all that is wrong with it; BadInput says what flight
    would refuse, and for a search space by which command it is built."""
    kind = source_kind(source)
    if kind == "space":
        raise BadInput(
            "a search space is not built like other tables", str(source), "use `kincal space build`"
        )
    struct = new(kind)
    fill(struct, _doc(validate(SOURCES[kind], read_toml(source), str(source)), str(source)), str(source))
    image = encode(kind, struct)
    decode(image.data, str(source))  # what flight would refuse is refused here
    return image


def load(path: Path, build_source: Callable[[Path], Image] = build) -> tuple[Image, Table]:
    """Image and struct of a .tbl file, or of a .toml source as `build_source` builds it. BadInput
    otherwise."""
    if path.suffix == ".toml":
        return decode(build_source(path).data, str(path))
    try:
        data = path.read_bytes()
    except OSError as error:
        todo = "name a table image (*.tbl) or its source (*.toml)"
        raise BadInput(f"cannot read: {error.strerror}", str(path), todo) from None
    return decode(data, str(path))


def compared(image: Image, struct: Table, folder: Path) -> str:
    """What a TERMS or SPACE table was compared with, in words: the other of the two in a folder, with the ARM
    table there. BadInput if flight would refuse the one beside the other; "" for other kinds of tables."""
    other = {"terms": "space", "space": "terms"}.get(image.kind)
    if other is None:
        return ""
    missing = [f"{kind}.tbl" for kind in ("arm", other) if not (folder / f"{kind}.tbl").is_file()]
    if missing:
        return f"its bounds were not compared: {folder} holds no {' and no '.join(missing)}"
    path = folder / f"{other}.tbl"
    arm_image, arm = decode_as("arm", (folder / "arm.tbl").read_bytes(), str(folder / "arm.tbl"))
    if image.kind == "terms":
        space, terms = decode_as("space", path.read_bytes(), str(path))[1], cast("KcTerms", struct)
    else:
        space, terms = cast("KcSpace", struct), decode_as("terms", path.read_bytes(), str(path))[1]
    if space.arm_crc != arm_image.crc:
        return (
            f"its bounds were not compared: the search space is for another arm table than {folder}/arm.tbl"
        )
    if excess := Flown(arm, space).excess(terms):
        raise BadInput(f"{image.kind} table refused beside {path}: {excess.text}")
    return f"bounds agree with {path}"


def build_order(sources: list[Path]) -> list[Path]:
    """Sources with spaces last: they are built for the arm and camera tables beside them."""
    return sorted(sources, key=lambda path: (read_toml(path).get("kind") == "space", path.name))


def _doc(source: Source, where: str) -> Doc:
    """The source with the fields of its struct, everything written out."""
    match source:
        case ArmSource():
            return _arm_doc(source)
        case TermsSource():
            return _terms_doc(source)
        case KernelSource():
            return _kernel_doc(source, where)
        case KinSource():
            return _kin_doc(source)
    return _fields(source)


def _fields(source: Source, *without: str) -> Doc:
    return source.model_dump(mode="json", exclude=_FOR_PEOPLE | set(without))


def _arm_doc(source: ArmSource) -> Doc:
    """has_mass follows from what is given; joint_name is for people."""
    doc = _fields(source)
    for joint in doc["joint"]:
        del joint["joint_name"]
        joint["has_mass"] = int(joint["mass_kg"] is not None)
        joint["mass_kg"] = joint["mass_kg"] or 0.0
        joint["com_m"] = joint["com_m"] or [0.0, 0.0, 0.0]
    return doc


def _kin_doc(source: KinSource) -> Doc:
    doc = _fields(source, "n_coef")
    if source.n_coef is not None:
        doc |= {"value": [0.0] * source.n_coef, "sigma": [0.0] * source.n_coef}
    return doc


def _kernel_doc(source: KernelSource, where: str) -> Doc:
    """Every [[set]] becomes the grid of its lists."""
    hyper = []
    for entry in source.set:
        lists = (
            x if isinstance(x, list) else [x] for x in (entry.nu, entry.kappa, entry.beta_m, entry.sigma_s)
        )
        hyper += [_hyperparameters(source.arg, values, where) for values in itertools.product(*lists)]
    return _fields(source, "set") | {"hyper": hyper}


def _hyperparameters(arg: str, values: tuple[float, ...], where: str) -> Doc:
    nu, kappa, beta_m, sigma_s = values
    try:
        spectrum = spectral_table(arg, kappa, nu)
    except ValueError as error:
        raise BadInput(str(error), where) from None
    w, trunc_err = [float(w) for w in spectrum.w], float(spectrum.trunc_err)
    return {"sigma_s": sigma_s, "beta_m": beta_m, "kappa": kappa, "nu": nu, "w": w, "trunc_err": trunc_err}


# --------------------------------------------------------------------------- correction terms

# joint[j] is the axis of a revolute joint; a terms table does not know the arm's joint types
_OWN_AXIS = "rz"


def _terms_doc(source: TermsSource) -> Doc:
    """[dh] and per-joint coefficients written out; terms numbered by coefficient."""
    coefs: list[Doc] = []
    terms: list[Doc] = []
    dh = _dh_entries(source.dh) if source.dh else ()
    for entry in itertools.chain(dh, source.coef):
        for j in entry.joints if entry.joints is not None else (None,):
            terms += [_term_doc(term, len(coefs), j) for term in entry.term]
            coefs.append(_coef_doc(entry, j))
    return {"coef": coefs, "term": terms, "kinematics_crc": source.kinematics_crc}


def _dh_entries(dh: DhBlock) -> Iterator[CoefEntry]:
    for j in range(1, dh.joints + 1):
        for error in DH_ERRORS:
            name = error.name
            bound = getattr(dh.bound, name)
            bound = bound[j - 1] if isinstance(bound, list) else bound
            yield CoefEntry(
                name=f"J{{j}}.{name}",
                joints=[j],
                lb=-bound,
                ub=bound,
                prior_sigma=getattr(dh.prior_sigma, name),
                scale=getattr(dh.scale, name),
                enabled=dh.enabled,
                term=[TermEntry(at=f"{error.at}[j]", comp=error.comp)],
            )


def _coef_doc(entry: CoefEntry, j: int | None) -> Doc:
    doc = entry.model_dump(include={"lb", "ub", "prior_sigma", "scale"})
    return doc | {"name": entry.name.replace("{j}", str(j)), "enabled": int(entry.enabled)}


def _term_doc(term: TermEntry, coef: int, j: int | None) -> Doc:
    names = {} if j is None else {"j": float(j), "p": float(j - 1)}
    frame = term.place.frame(names)
    return {
        "coef": coef,
        "frame": _special_frames()[frame] if isinstance(frame, str) else frame,
        "comp": term.comp or _OWN_AXIS,
        "gain": float(term.gain),
        "basis": [
            {"fn": b.fn, "var": b.flight_var, "index": b.index, "c0": b.c0, "c1": b.c1}
            for b in term.bases(names)
        ],
    }


@cache
def _special_frames() -> dict[str, int]:
    flight = library("flight")
    return {name: flight.constant(f"KC_FRAME_{name.upper()}") for name in ("tool", "camera", "meas")}


# --------------------------------------------------------------------------- for people


def readable(struct: Table) -> Doc:
    """A struct as a dict of plain values, correction terms in the grammar of the sources."""
    doc = to_doc(struct)
    if "term" in doc:
        doc["term"] = [_readable_term(term) for term in doc["term"]]
    return doc


def _readable_term(term: Doc) -> Doc:
    frame = next(
        (name for name, number in _special_frames().items() if number == term["frame"]), term["frame"]
    )
    first, second = (_basis(b) for b in term["basis"])
    return {
        "coef": term["coef"],
        "at": place_text(frame),
        "comp": term["comp"],
        "gain": term["gain"],
        "basis": basis_text(first, second),
    }


def _basis(doc: Doc) -> Basis:
    if doc["var"] == ONE.flight_var:
        return ONE
    var = next(name for name, variable in VARIABLES.items() if variable.flight == doc["var"])
    return Basis(doc["fn"], var, doc["index"], doc["c0"], doc["c1"])


def unit_of(coef: str) -> str:
    """Unit of a coefficient from its name; "" if the name does not say it."""
    if coef.startswith("encoder_gain"):
        return "rad/rad"
    if coef.startswith("joint_compliance"):
        return "rad/(N m)"
    return "rad" if coef.endswith("_rad") else "m" if coef.endswith("_m") else ""


# --------------------------------------------------------------------------- differences


@dataclass(frozen=True)
class Change:
    """A field that differs: its path, and its values in the two tables (None where it is absent)."""

    path: str
    a: Any
    b: Any


def flatten(doc: Any, path: str = "") -> Doc:
    """path -> value; list entries that carry a name go by it, others by their number from 0."""
    out: Doc = {}
    if isinstance(doc, dict):
        for key, value in doc.items():
            out |= flatten(value, f"{path}.{key}" if path else key)
    elif isinstance(doc, list):
        for i, value in enumerate(doc):
            tag = value["name"] if isinstance(value, dict) and value.get("name") else str(i)
            out |= flatten(value, f"{path}[{tag}]")
    elif isinstance(doc, bytes):
        bits = sum(byte.bit_count() for byte in doc)
        out[path] = f"{bits} bits set, {len(doc)} bytes, hash {zlib.crc32(doc):08x}"
    else:
        out[path] = doc
    return out


def diff(
    a: Path, b: Path, build_source: Callable[[Path], Image] = build
) -> tuple[Image, Image, list[Change]]:
    """Every field that differs between two tables of one kind. BadInput if they are of two kinds."""
    image_a, struct_a = load(a, build_source)
    image_b, struct_b = load(b, build_source)
    if image_a.kind != image_b.kind:
        raise BadInput(
            f"{image_a.kind} and {image_b.kind} tables cannot be compared",
            f"{a} {b}",
            "name two tables of the same kind",
        )
    flat_a, flat_b = flatten(readable(struct_a)), flatten(readable(struct_b))
    keys = dict.fromkeys((*flat_a, *flat_b))
    changes = [Change(k, flat_a.get(k), flat_b.get(k)) for k in keys if flat_a.get(k) != flat_b.get(k)]
    return image_a, image_b, changes
