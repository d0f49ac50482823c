"""One case of a campaign: a scenario in which some values differ, flown in this process.

What was asked for is read back from what was built: the errors of MuJoCo's bodies, the encoders and
effects of the plant, the settings of the detection model, the table image that flight had. A world that
differs from what was asked for is an error, not a case."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from kincal import tables as table_sources
from kincal.flight import library, tables
from kincal.link import Session, names, unsigned32
from kincal.results import Flown, Value
from kincal.review import KIN_KIND
from kincal_shared.errors import BadInput
from kincal_shared.schema.campaign import split_key
from kincal_shared.schema.errors import validate
from kincal_shared.schema.scenario import Scenario
from kincal_sim import scenario as scenarios  # noqa: E402  after inprocess, which says what is missing
from kincal_sim.mechanics.effects import Hysteresis, JointCompliance  # noqa: E402
from kincal_sim.truth import truth_record  # noqa: E402
from kincal_sim.vision.imagers import fast_imager  # noqa: E402
from kincal_sim.world import World  # noqa: E402

from .evaluate import Evaluator, GroundTruth
from .inprocess import Setup, SimulatedRun, Simulation

COMPARED = frozenset(("KC_ARM_CMD", "KC_PANTILT_CMD", "KC_MEAS", "KC_PROGRESS", "KC_PROPOSAL", "KC_EVENT"))
SAME = 1e-6  # relative; CONFIG has fields of single precision
TABLES_KEY = "tables"


# ---- before


def load(name: str, beside: Path) -> dict[str, Any]:
    """A scenario by name or file (relative to a folder) as plain values. BadInput if there is none."""
    file = beside / name
    scenario = scenarios.load(file if file.is_file() else name)
    return scenario.model_dump(exclude_none=True)


def changed(base: Mapping[str, Any], changes: Mapping[str, Value]) -> Scenario:
    """The scenario with the changes that concern it. SchemaError names a value that it cannot have."""
    doc = _copied(base)
    for key, value in changes.items():
        path = split_key(key)
        if path[0] not in ("config", TABLES_KEY):
            here = doc
            for part in path[:-1]:
                here = here.setdefault(part, {})
            here[path[-1]] = value
    return scenarios.checked(validate(Scenario, doc, "the scenario with its changes"))


def _copied(base: Mapping[str, Any]) -> dict[str, Any]:
    return {k: _copied(v) if isinstance(v, Mapping) else v for k, v in base.items()}


@contextmanager
def tables_with(folder: Path, changes: Mapping[str, Value]) -> Iterator[Path]:
    """The folder with table images; with changes of CONFIG, another one that has them. BadInput for values
    that flight would refuse."""
    wanted = {key: value for key, value in changes.items() if key.startswith("config.")}
    if not wanted:
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="kincal-case-") as name:
        for image in folder.glob("*.tbl"):
            shutil.copyfile(image, Path(name) / image.name)
        target = Path(name) / "config.tbl"
        _, config = tables.decode_as("config", target.read_bytes())
        for key, value in wanted.items():
            _set_field(config, split_key(key)[1:], value, key)
        data = tables.encode("config", config).data
        tables.decode(data, "the CONFIG table with its changes")  # what flight would refuse
        target.write_bytes(data)
        yield Path(name)


def _set_field(config: Any, path: list[str], value: Value, key: str) -> None:
    for part in path[:-1]:
        config = getattr(config, part)
    known = tables.names_of_field("kc_config_t", path[-1])
    if isinstance(value, str):
        if value not in known:
            raise BadInput(f"{value!r} is no value of {path[-1]}", key, f"known: {', '.join(known)}")
        value = known.index(value)
    whole = isinstance(getattr(config, path[-1]), int)
    if whole and float(value) != int(value):
        raise BadInput(f"{value:g} is no whole number, which {path[-1]} is", key, "use choice = [1, 2, ...]")
    setattr(config, path[-1], int(value) if whole else float(value))


# ---- the case


def fly(
    base: Mapping[str, Any],
    folder: Path,
    changes: Mapping[str, Value],
    seed: int,
    log: Path | None = None,
) -> Flown:
    """One case. base: the scenario as `load` gives it; folder: of table images; changes: value by key;
    seed: of everything random; log: file for an LCM log. ArithmeticError if the world was not built as
    asked."""
    begun = time.process_time()
    scenario = changed(base, changes)
    with (
        tables_with(folder, changes) as used,
        Simulation(scenario, seed, Setup(tables=used, log=log, world=_world)) as simulation,
    ):
        world, digest = simulation.world, hashlib.sha256()
        evaluator = _evaluator(folder)
        evaluator.learn(GroundTruth.of(truth_record(simulation.scenario, world.plant, seed, "fast")))
        found = read_back(changes, world, used, folder)
        check(changes, found)
        while (tick := simulation.until_sent()) is not None:
            for channel, message in tick.from_flight:
                if channel in COMPARED:
                    digest.update(channel.encode() + message.encode())
        outcome = _outcome(simulation.result(), evaluator)
    digest.update(repr(sorted(outcome.items())).encode())
    return Flown(found, outcome, digest.hexdigest(), time.process_time() - begun)


def _world(scenario: Scenario, seed: int) -> World:
    return World(scenario, seed, fast_imager)


def _evaluator(folder: Path) -> Evaluator:
    """By the tables; a new one for each folder with other contents. It uses nothing of CONFIG, so that cases
    with other values there share one."""
    return _evaluators(folder, tuple(sorted(crcs(folder).items())))


@cache
def _evaluators(folder: Path, _crcs: tuple[tuple[str, str], ...]) -> Evaluator:
    return Evaluator(folder)


def _outcome(run: SimulatedRun, evaluator: Evaluator) -> dict[str, Value | None]:
    """The columns of OUTCOME."""
    record, log = run.record, run.log
    session = log.last_session or Session(0)
    proposal, before = session.proposal, evaluator.held_out(evaluator.initial_coef)
    found: dict[str, Value | None] = {
        "ended": "no end" if not run.ended else "finished" if proposal is not None else "stopped",
        "reason": str(record.get("reason", "")),
        "verdict": str(record.get("verdict", "")),
        "success": bool(record.get("success", False)),
        "poses": len(session.progress),
        "active": False,
        "before_pos_m": before.pos_m,
        "before_rot_rad": before.rot_rad,
        "after_pos_m": before.pos_m,
        "after_rot_rad": before.rot_rad,
        "contacts_s": float(sum(run.contacts.values())),
        "mission_s": run.mission_s,
    }
    if proposal is None:
        return found | dict.fromkeys(
            ("outliers", "proposed_pos_m", "proposed_rot_rad", "pred_pos_m", "pred_rot_rad", "p_fit")
        )
    proposed = evaluator.held_out(np.array(proposal.value[: evaluator.terms.n]))
    in_force = unsigned32(log.hk.table_crc[KIN_KIND]) if log.hk else 0
    active = names.verdict_key(proposal.verdict) == "change" and in_force == unsigned32(proposal.crc)
    found |= {
        "active": active,
        "outliers": int(proposal.n_outliers),
        "proposed_pos_m": proposed.pos_m,
        "proposed_rot_rad": proposed.rot_rad,
        "pred_pos_m": proposal.pred_pos_m,
        "pred_rot_rad": proposal.pred_rot_rad,
        "p_fit": proposal.p_fit,
    }
    if active:
        found |= {"after_pos_m": proposed.pos_m, "after_rot_rad": proposed.rot_rad}
    return found


# ---- read back


def check(asked: Mapping[str, Value], found: Mapping[str, Value]) -> None:
    """ArithmeticError unless what was found is what was asked for."""
    for key, want in asked.items():
        got = found[key]
        if isinstance(want, (bool, str)) or isinstance(got, str):
            same = str(want) == str(got)
        else:
            same = bool(abs(float(got) - float(want)) <= SAME * max(abs(float(want)), 1e-3))
        if not same:
            raise ArithmeticError(f"the world has {key} = {got!r}, asked for was {want!r}")


def read_back(keys: Iterable[str], world: World, used: Path, folder: Path) -> dict[str, Value]:
    """Values of the built world, or of the tables that flight gets, by key."""
    errors = cache(lambda of: geometry_errors(world, of))
    return {key: _read_back(key, world, used, folder, errors) for key in keys}


def _read_back(
    key: str, world: World, used: Path, folder: Path, errors: Callable[[str], dict[str, float]]
) -> Value:
    """errors: geometry_errors() of a joint, "base" or "tool"."""
    path = split_key(key)
    match path:
        case ["tables"]:
            return str(folder)
        case ["config", *field]:
            return _config_value(used, field)
        case ["arm", "errors", name]:
            return errors(name.partition(".")[0])[name]
        case ["arm", "encoder_bias_rad", joint]:
            return float(world.plant.encoders.bias_rad[_index(joint)])
        case ["arm", "encoder_gain", joint]:
            return float(world.plant.encoders.gain[_index(joint)])
        case ["arm", "compliance_rad_per_nm", joint]:
            found = [
                e.rad_per_nm[_index(joint)] for e in world.plant.effects if isinstance(e, JointCompliance)
            ]
            return float(sum(found))
        case ["arm", "hysteresis_rad", joint]:
            return float(sum(e.rad[_index(joint)] for e in world.plant.effects if isinstance(e, Hysteresis)))
        case ["env", "payload_kg"]:
            return _payload_kg(world)
        case ["detection", name]:
            value: Value = world.imager.settings[name]
            return value
    here: Any = world.scenario
    for part in path:
        here = getattr(here, part)
    result: Value = here
    return result


def _index(joint: str) -> int:
    return int(joint[1:]) - 1


def _payload_kg(world: World) -> float:
    model = world.arm.model
    names_ = [model.body(i).name for i in range(model.nbody)]
    return float(model.body("payload").mass[0]) if "payload" in names_ else 0.0


def _config_value(used: Path, field: list[str]) -> Value:
    _, config = tables.decode_as("config", (used / "config.tbl").read_bytes())
    here: Any = config
    for part in field:
        here = getattr(here, part)
    known = tables.names_of_field("kc_config_t", field[-1])
    return known[int(here)] if known else here


def geometry_errors(world: World, of: str) -> dict[str, float]:
    """Errors of a joint (J1..), of "base" or of "tool" from MuJoCo's bodies: where they are less where the
    nominal arm has them [rad, m]."""
    arm = world.arm
    if of in ("base", "tool"):
        built = arm.model.body("frame0" if of == "base" else of)
        return _frame_error(of, built.pos - arm.spec[of]["xyz_m"], built.quat)
    j = _index(of)
    nominal, frame = arm.spec["joint"][j], arm.model.body(f"frame{j + 1}")
    phi = Rotation.from_quat(arm.model.body(f"link{j + 1}").quat, scalar_first=True)
    alpha = Rotation.from_quat(frame.quat, scalar_first=True)
    return {
        f"{of}.phi_rad": _turn(phi, 2, nominal.get("phi_rad", 0.0)),
        f"{of}.alpha_rad": _turn(alpha, 0, nominal["alpha_rad"]),
        f"{of}.a_m": float(frame.pos[0] - nominal["a_m"]),
        f"{of}.d_m": float(frame.pos[2] - nominal["d_m"]),
    }


def _turn(R: Rotation, axis: int, nominal_rad: float) -> float:
    """Angle about an axis less its nominal value, nearest to zero."""
    off = float(R.as_rotvec()[axis]) - nominal_rad
    return float((off + np.pi) % (2 * np.pi) - np.pi)


def _frame_error(name: str, t_m: Any, quat: Any) -> dict[str, float]:
    """The six numbers of a frame error, which is Tx Rx Ty Ry Rz Tz."""
    R = Rotation.from_quat(quat, scalar_first=True)
    r_rad = R.as_euler("XYZ")
    Rx = Rotation.from_euler("x", r_rad[0]).as_matrix()
    axes = np.column_stack([[1.0, 0.0, 0.0], Rx[:, 1], R.as_matrix()[:, 2]])
    t = np.linalg.solve(axes, np.asarray(t_m, float))
    pairs = zip("xyz", t, r_rad, strict=True)
    return {k: float(v) for x, p, r in pairs for k, v in ((f"{name}.t{x}_m", p), (f"{name}.r{x}_rad", r))}


# ---- what a case depends on


def crcs(folder: Path) -> dict[str, str]:
    """CRC by kind of the table images in a folder. BadInput if one is missing or cannot be read."""
    kinds = [kind for kind in tables.kinds() if kind != "none"]
    found = {}
    for image in sorted(folder.glob("*.tbl")):
        found[image.stem] = table_sources.load(image)[0].crc_text
    if missing := [kind for kind in kinds if kind not in found]:
        raise BadInput(f"no table image {missing[0]}.tbl", str(folder), "run `kincal table build` into it")
    return found


@cache
def tables_of(folder: Path) -> Path:
    """A folder with table images that flight can use, as an absolute path. BadInput if it is none."""
    if not folder.is_dir():
        raise BadInput("no such folder", str(folder), "name a folder with table images, such as tables/bin")
    crcs(folder)
    library("flight")
    return folder.resolve()
