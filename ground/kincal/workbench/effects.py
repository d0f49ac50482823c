"""The effect library: physical effects as named bundles of correction terms, from TOML."""

from __future__ import annotations

import itertools
import math
import tomllib
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import numpy as np

from kincal.errors import BadInput

from .arms import ArmTable, quat_to_matrix
from .basis import Basis, parse_basis
from .data import Measurements

FRAME_TOOL, FRAME_CAMERA, FRAME_MEAS = 9, 10, 11
# sensor: the measurement frame itself where the data have no camera columns (tracker, board)
_PLACES = {
    "base": 0,
    "tool": FRAME_TOOL,
    "camera": FRAME_CAMERA,
    "sensor": FRAME_CAMERA,
    "meas": FRAME_MEAS,
}
COMPONENTS = {"tx": 0, "ty": 1, "tz": 2, "rx": 3, "ry": 4, "rz": 5}
_PER = ("arm", "joint", "pair")
_EFFECT_KEYS = {
    "name", "title", "formula", "per", "pairs", "joints", "needs", "looks_like", "inspect",
    "confounded_with", "grid", "parameter", "twin_of",
}  # fmt: skip
_PARAMETER_KEYS = {"name", "unit", "sigma", "each_joint", "term"}
_TERM_KEYS = {"at", "comp", "gain", "basis"}
# Periods per turn that are tried where nobody knows them: joints turn by 3 to 6 rad, so that half a period
# more or less still looks alike.
_PERIODS = np.arange(3.0, 30.25, 0.5)
# How a need is said to people: the keys of the arm table or the columns of the data.
_NEED_TEXT = {
    "mass": "mass_kg, com_m (arm table)",
    "gear_ratio": "gear_ratio (arm table)",
    "mass_unknown": "an arm table without masses",
    "gear_unknown": "an arm table without gear ratios",
    "own_sensor": "data without camera columns",
    "dir": "dir1..",
    "cam": "cx..cqz",
    "image": "cx..cqz",
    "rotation": "qw..qz",
}


@dataclass(frozen=True)
class Term:
    """coefficient x gain x basis x basis, added to twist component `comp` at `frame`."""

    frame: int
    comp: int
    gain: float
    basis: tuple[Basis, Basis]


@dataclass(frozen=True)
class Parameter:
    name: str
    unit: str
    sigma: float
    terms: tuple[Term, ...]


@dataclass(frozen=True)
class Hypothesis:
    """One testable instance: an effect at one joint (or pair) with its constants chosen."""

    effect: str
    name: str
    parameters: tuple[Parameter, ...]
    constants: tuple[tuple[str, float], ...] = ()

    @property
    def label(self) -> str:
        """Name with the searched constants, e.g. bias_step[3] (t0 = 120)."""
        if not self.constants:
            return self.name
        return f"{self.name} ({', '.join(f'{k} = {v:.4g}' for k, v in self.constants)})"


@dataclass(frozen=True)
class Effect:
    """One entry of the library as written; `instances` makes it concrete for an arm and data."""

    name: str
    title: str
    formula: str
    per: str
    needs: tuple[str, ...]
    looks_like: str
    inspect: str
    confounded_with: tuple[str, ...]
    parameters: tuple[dict, ...]
    joints: tuple[int, ...] | None = None
    pairs: tuple[tuple[int, int], ...] | None = None
    grid: dict = field(default_factory=dict)
    twin_of: str = ""
    source: str = ""

    def missing(self, arm: ArmTable, data: Measurements | None) -> list[str]:
        """What this effect needs and the arm table or the data do not have."""
        lacking = []
        for need in self.needs:
            if need == "mass":
                there = arm.has_masses
            elif need == "mass_unknown":
                there = not arm.has_masses
            elif need == "gear_unknown":
                there = not arm.has_gears
            elif need == "gear_ratio":
                there = arm.has_gears
            elif need == "image":
                there = data is None or data.has("cam")
            elif need == "own_sensor":
                there = data is not None and data.has(need)
            else:
                there = data is None or data.has(need)
            if not there:
                lacking.append(_NEED_TEXT.get(need, need))
        return list(dict.fromkeys(lacking))

    def where(self, arm: ArmTable) -> list[dict[str, int]]:
        """The joint letters of each instance: {} for the arm, {j} per joint, {i, j} per pair."""
        joints = self.joints or tuple(range(1, arm.n + 1))
        if self.per == "arm":
            return [{}]
        if self.per == "joint":
            return [{"j": j} for j in joints if j <= arm.n]
        pairs = self.pairs or tuple(itertools.permutations(joints, 2))
        return [{"i": i, "j": j} for i, j in pairs if max(i, j) <= arm.n]

    def instances(
        self, arm: ArmTable, data: Measurements | None, known: dict[str, float] | None = None
    ) -> list[Hypothesis]:
        """Every joint (or pair) times every grid value. Constants named in the grid come from the data,
        or are known from an earlier fit."""
        known = known or {}
        fixed = {**data_constants(data), **known}
        grids = {
            name: [known[name]] if name in known else _grid_values(name, values, data, self.source)
            for name, values in self.grid.items()
        }
        out = []
        for letters in self.where(arm):
            for combo in itertools.product(*grids.values()):
                constants = tuple(zip(grids, combo, strict=True))
                parameters = self._concrete(arm, letters, {**fixed, **dict(constants)})
                out.append(Hypothesis(self.name, instance_name(self.name, letters), parameters, constants))
        return out

    def _concrete(self, arm: ArmTable, letters: dict[str, int], constants: dict) -> tuple[Parameter, ...]:
        made = []
        for raw in self.parameters:
            loops = [{**letters, "j": j} for j in range(1, arm.n + 1)] if raw.get("each_joint") else [letters]
            terms = []
            for names in loops:
                for term in raw["term"]:
                    terms += _concrete_term(term, arm, names, constants, f"{self.source}: effect {self.name}")
            terms = tuple(term for term in terms if term.gain != 0.0)
            made.append(Parameter(raw["name"], raw.get("unit", "1"), float(raw["sigma"]), terms))
        return tuple(made)


def instance_name(effect: str, letters: dict[str, int]) -> str:
    if not letters:
        return effect
    return f"{effect}[{','.join(str(letters[k]) for k in sorted(letters))}]"


def data_constants(data: Measurements | None) -> dict[str, float]:
    """Reference temperature and begin of time, which bases may use as $T0 and $tstart."""
    if data is None:
        return {"T0": 20.0, "tstart": 0.0}
    return {
        "T0": float(np.mean(data.temp_c)) if data.temp_c is not None else 20.0,
        "tstart": float(np.min(data.t_s)) if data.t_s is not None else 0.0,
    }


def _grid_values(name: str, values, data: Measurements | None, source: str) -> list[float]:
    if isinstance(values, list):
        return [float(v) for v in values]
    if values == "periods":
        return [float(v) for v in _PERIODS]
    if data is None or data.t_s is None:
        return [0.0 if values == "times" else 1.0]
    t = np.unique(data.t_s)
    span = float(t[-1] - t[0]) or 1.0
    if values == "durations":
        return [span / 30.0, span / 8.0, span / 2.0]
    if values == "times":
        # a step is placed midway between two measurements, a few poses away from either end
        middles = 0.5 * (t[1:] + t[:-1])
        inner = middles[2:-2] if len(middles) > 8 else middles
        return [float(v) for v in inner[np.unique(np.linspace(0, len(inner) - 1, 16).round().astype(int))]]
    raise BadInput(
        f'{source}: grid {name} is {values!r}; a list of numbers, "times", "durations" or "periods" is needed'
    )


def finer(values, best: float, data: Measurements) -> list[float]:
    """Values around the best one of a coarse grid, closer than its neighbours; empty if there are none."""
    if values == "periods":
        step = _PERIODS[1] - _PERIODS[0]
        return [float(v) for v in best + step * np.linspace(-0.8, 0.8, 9)]
    if values == "durations":
        return [float(v) for v in best * 2.0 ** np.linspace(-1.0, 1.0, 9)]
    if values != "times":
        return []
    t, t0 = np.unique(data.t_s), best
    middles = 0.5 * (t[1:] + t[:-1])
    place = int(np.abs(middles - t0).argmin())
    reach = max(1, round(len(middles) / 16))
    return [float(v) for v in middles[max(place - reach, 0) : place + reach + 1]]


def _link_vector(arm: ArmTable, j: int) -> np.ndarray:
    """Origin of frame j-1 to origin of frame j, in frame j."""
    joint = arm.joints[j - 1]
    return np.array([joint.a_m, joint.d_m * math.sin(joint.alpha_rad), joint.d_m * math.cos(joint.alpha_rad)])


def _mount_lever(arm: ArmTable) -> np.ndarray:
    """From the origin of the base frame, where the arm is bolted on, to frame 0, in frame 0 [m]; a mount that
    tips turns about that origin. Zero when the base frame is unknown."""
    if arm.base.estimate:
        return np.zeros(3)
    return quat_to_matrix(arm.base.quat_wxyz).T @ arm.base.xyz_m


def _gain(value, arm: ArmTable, names: dict[str, int], where: str) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    text = str(value).replace(" ", "")
    factor = 1.0
    symbols = dict(zip(("Bx", "By", "Bz"), _mount_lever(arm), strict=True))
    if "j" in names:
        length = _link_vector(arm, names["j"])
        joint = arm.joints[names["j"] - 1]
        symbols |= dict(zip(("Lx", "Ly", "Lz"), length, strict=True)) | {"a": joint.a_m, "d": joint.d_m}
        symbols["long"] = float(np.linalg.norm(length) > 1e-6)
    for part in text.split("*"):
        sign = -1.0 if part.startswith("-") else 1.0
        part = part.lstrip("+-")
        try:
            factor *= sign * (symbols[part] if part in symbols else float(part))
        except ValueError:
            raise BadInput(
                f"{where}: gain {value!r}: {part!r} is neither a number nor Lx Ly Lz a d long Bx By Bz"
            ) from None
    return factor


def _concrete_term(
    raw: dict, arm: ArmTable, names: dict[str, int], constants: dict, where: str
) -> list[Term]:
    at, comp = raw["at"], raw.get("comp")
    values: dict[str, float] = {**constants, **names}
    if "j" in names:
        values["p"] = names["j"] - 1  # the link before
    if "j" in names and arm.joints[names["j"] - 1].gear_ratio:
        values["N"] = arm.joints[names["j"] - 1].gear_ratio
    kind, _, token = at.partition("[")
    token = token.rstrip("]")
    if kind in ("joint", "link", "before"):
        index = int(token) if token.isdigit() else names.get(token)
        if index is None or not 1 <= index <= arm.n:
            raise BadInput(f"{where}: at = {at!r} names no joint of this arm (1 to {arm.n})")
        if kind == "joint":
            frame, comp = index - 1, "tz" if arm.joints[index - 1].prismatic else "rz"
        else:
            frame = index if kind == "link" else index - 1
    elif kind in _PLACES:
        frame = _PLACES[kind]
    else:
        raise BadInput(
            f"{where}: at = {at!r}; joint[j], before[j], link[j], {', '.join(_PLACES)} are possible"
        )
    if comp not in COMPONENTS:
        raise BadInput(f"{where}: comp is {comp!r}; one of {', '.join(COMPONENTS)} is needed at {kind}")
    basis = parse_basis(raw["basis"], values, where) if "basis" in raw else parse_basis("1", values, where)
    for factor in basis:
        if factor.index > arm.n:
            raise BadInput(f"{where}: basis {raw['basis']!r} names joint {factor.index}, the arm has {arm.n}")
    return [Term(frame, COMPONENTS[comp], _gain(raw.get("gain", 1.0), arm, names, where), basis)]


class Library:
    """Effects by name, the built-in ones and a user's own."""

    def __init__(self, effects: list[Effect]):
        self.effects = {effect.name: effect for effect in effects}

    @classmethod
    def load(cls, *user_files: str | Path) -> Library:
        text = resources.files(__package__).joinpath("effects.toml").read_text(encoding="utf-8")
        effects = _read_library(text, "effects.toml")
        for path in user_files:
            try:
                text = Path(path).read_text(encoding="utf-8")
            except OSError as error:
                raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
            mine = _read_library(text, str(path))
            names = {effect.name for effect in effects}
            for effect in mine:
                if effect.name in names:
                    raise BadInput(
                        f"{path}: effect {effect.name!r} is already in the library; choose another name"
                    )
            effects += mine
        return cls(effects)

    def without(self, *names: str) -> Library:
        return Library([effect for effect in self.effects.values() if effect.name not in names])

    def grid_of(self, name: str, known: dict[str, float] | None = None) -> dict:
        """Constants of an effect that have to be searched, those that are known left out."""
        effect = self.effects.get(name.partition("[")[0])
        return {} if effect is None else {k: v for k, v in effect.grid.items() if k not in (known or {})}

    def find(
        self,
        name: str,
        arm: ArmTable,
        data: Measurements | None,
        known: dict[str, float] | None = None,
    ) -> list[Hypothesis]:
        """Instances for `name[joint]`, or all joints for a bare name. BadInput with near names."""
        base = name.partition("[")[0]
        if base not in self.effects:
            near = [n for n in self.effects if n.startswith(base[:4])] or list(self.effects)
            raise BadInput(f"no effect {base!r}; did you mean {', '.join(near[:6])}? (kincal model effects)")
        found = self.effects[base].instances(arm, data, known)
        if "[" in name:
            wanted = name.replace(" ", "")
            found = [h for h in found if h.name == wanted]
            if not found:
                raise BadInput(f"effect {name!r}: no such joint on {arm.name} ({arm.n} joints)")
        return found


def _read_library(text: str, source: str) -> list[Effect]:
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"{source}: not valid TOML: {error}") from None
    rows = table.get("effect", [])
    if not rows:
        raise BadInput(f"{source}: holds no [[effect]] table")
    return [_read_effect(row, source) for row in rows]


def _check_keys(row: dict, allowed: set[str], where: str) -> None:
    unknown = sorted(set(row) - allowed)
    if unknown:
        raise BadInput(f"{where}: unknown key {unknown[0]!r}; known: {', '.join(sorted(allowed))}")


def _read_effect(row: dict, source: str) -> Effect:
    name = row.get("name")
    where = f"{source}: effect {name or '?'}"
    _check_keys(row, _EFFECT_KEYS, where)
    if not isinstance(name, str) or not name.isidentifier():
        raise BadInput(f"{source}: an effect's name is {name!r}; letters, digits and _ are needed")
    per = row.get("per", "arm")
    if per not in _PER:
        raise BadInput(f"{where}: per is {per!r}; {', '.join(_PER)} are possible")
    parameters = row.get("parameter", [])
    if not parameters:
        raise BadInput(f"{where}: has no [[effect.parameter]]")
    needs = list(row.get("needs", []))
    for parameter in parameters:
        inside = f"{where}: parameter {parameter.get('name', '?')}"
        _check_keys(parameter, _PARAMETER_KEYS, inside)
        if not isinstance(parameter.get("name"), str):
            raise BadInput(f"{inside}: needs a name")
        sigma = parameter.get("sigma")
        if (
            isinstance(sigma, bool)
            or not isinstance(sigma, int | float)
            or not (math.isfinite(sigma) and sigma > 0)
        ):
            raise BadInput(f"{inside}: sigma (typical size) is {sigma!r}, a number above 0 is needed")
        if not parameter.get("term"):
            raise BadInput(f"{inside}: has no [[effect.parameter.term]]")
        for term in parameter["term"]:
            _check_keys(term, _TERM_KEYS, inside)
            if "at" not in term:
                raise BadInput(f"{inside}: a term needs at = ...")
            needs += _needs_of(term, inside)
    return Effect(
        name=name,
        title=row.get("title", name),
        formula=row.get("formula", ""),
        per=per,
        needs=tuple(dict.fromkeys(needs)),
        looks_like=row.get("looks_like", ""),
        inspect=row.get("inspect", ""),
        confounded_with=tuple(row.get("confounded_with", ())),
        parameters=tuple(parameters),
        joints=tuple(row["joints"]) if "joints" in row else None,
        pairs=tuple(tuple(pair) for pair in row["pairs"]) if "pairs" in row else None,
        grid=dict(row.get("grid", {})),
        twin_of=row.get("twin_of", ""),
        source=source,
    )


def _needs_of(term: dict, where: str) -> list[str]:
    letters = dict.fromkeys("ijp", 1)
    constants = {"T0": 0.0, "tstart": 0.0, "tau": 1.0, "t0": 0.0, "tau0": 1.0, "N": 1.0}
    text = term.get("basis", "1")
    if not isinstance(text, str):
        raise BadInput(f'{where}: basis is {text!r}; a text such as "tanh(q4) * cos(q6)" is needed')
    for token in _dollar_names(text):
        constants.setdefault(token, 1.0)
    needs = [basis.need for basis in parse_basis(text, {**constants, **letters}, where) if basis.need]
    if term["at"] in ("camera", "meas"):
        needs.append("cam")
    if term["at"] == "sensor":
        needs.append("own_sensor")
    return ["gear_ratio", *needs] if "N*" in text else needs


def _dollar_names(text: str) -> list[str]:
    return [part.split(")")[0].split("*")[0].split("/")[0].strip() for part in text.split("$")[1:]]
