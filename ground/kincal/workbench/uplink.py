"""The model as a term-table image: flight then estimates these coefficients with the DH errors."""

from __future__ import annotations

from pathlib import Path

from kincal import core, tables
from kincal.errors import BadInput

from .arms import ArmTable
from .chain import MAX_COEF, MAX_TERM, fill_coef, fill_term
from .effects import Hypothesis, Parameter
from .fit import dh_parameters

_NAME_MAX = 23
# Bounds and typical sizes of the DH errors on board (tables/src/terms.toml states the reasons).
_DH_BOUND = {"phi_rad": 1.5, "alpha_rad": 0.6, "a_m": 0.05, "d_m": 0.2}
_DH_SCALE = {"phi_rad": 0.1, "alpha_rad": 0.1, "a_m": 0.05, "d_m": 0.05}
_EFFECT_BOUND = 30.0  # prior sigmas


def flight_name(effect: str, parameter: str, alone: bool) -> str:
    """A coefficient name of at most 23 characters that keeps joint and parameter apart."""
    base, bracket, rest = effect.partition("[")
    tail = bracket + rest + ("" if alone else f".{parameter}")
    return base[: _NAME_MAX - len(tail)] + tail


def term_table(arm: ArmTable, hypotheses: list[Hypothesis]):
    """kc_terms_t with the DH errors and the effects' coefficients, all enabled."""
    rows: list[tuple[str, Parameter, float, float, float]] = []
    for name, parameter in dh_parameters(arm):
        rows.append((name, parameter, _DH_BOUND[parameter.name], 0.0, _DH_SCALE[parameter.name]))
    for h in hypotheses:
        for p in h.parameters:
            name = flight_name(h.name, p.name, len(h.parameters) == 1)
            rows.append((name, p, _EFFECT_BOUND * p.sigma, 3.0 * p.sigma, p.sigma))
    names = [row[0] for row in rows]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise BadInput(f"two coefficients would be called {doubled[0]!r} on board; shorten the effect's name")
    n_terms = sum(len(row[1].terms) for row in rows)
    if len(rows) > MAX_COEF or n_terms > MAX_TERM:
        raise BadInput(
            f"the model needs {len(rows)} coefficients and {n_terms} terms; "
            f"flight carries {MAX_COEF} and {MAX_TERM}"
        )
    out = core.ffi.new("kc_terms_t *")
    k = 0
    for c, (name, parameter, bound, prior, scale) in enumerate(rows):
        fill_coef(out.coef[c], name, parameter, bound)
        out.coef[c].prior_sigma, out.coef[c].scale = prior, scale
        for term in parameter.terms:
            fill_term(out.term[k], c, term)
            k += 1
    out.n_coef, out.n_term = len(rows), k
    return out


def flight_tables(source: Path, out: Path, terms: tables.Image) -> list[Path]:
    """A directory of table images to fly with: those of `source`, these terms, and no correction yet (the
    one in force belongs to the old terms)."""
    if source.resolve() == out.resolve():
        raise BadInput(f"{out} holds the tables to copy; name another directory")
    images = sorted(source.glob("*.tbl"))
    if not images:
        raise BadInput(f"{source}: holds no table image (*.tbl)")
    out.mkdir(parents=True, exist_ok=True)
    kin = core.ffi.new("kc_kin_t *")
    kin.n_coef = tables.decode(terms.data)[1].n_coef
    new = {"terms.tbl": terms.data, "kin.tbl": tables.encode("kin", kin).data}
    for image in images:
        (out / image.name).write_bytes(new.get(image.name) or image.read_bytes())
    return [out / image.name for image in images]


def term_image(arm: ArmTable, hypotheses: list[Hypothesis]) -> tables.Image:
    """The encoded image, checked by flight's own validation for this arm."""
    struct = term_table(arm, hypotheses)
    index, got = core.ffi.new("int32_t *"), core.ffi.new("double *")
    status = core.lib.kc_terms_validate(struct, arm.n, index, got)
    if status != 0:
        raise BadInput(
            f"flight would refuse the term table: {core.status_name(status)}, entry {index[0]}, "
            f"value {got[0]:g}"
        )
    return tables.encode("terms", struct)
