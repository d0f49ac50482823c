"""The folder of a campaign: campaign.json says what it belongs to, part-NNNNNN.parquet hold the cases.

A part is written whole or not at all: under another name, to the disk, then renamed. What is done is the set
of indices in the parts."""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from kincal_shared.errors import BadInput, CommandFailed
from kincal_shared.schema.campaign import OUTCOME, Campaign
from kincal_shared.schema.errors import validate

from .function import DIED, DISPERSED, FIXED
from .plan import Plan, contents_of, hash_of
from .pool import Answer

if TYPE_CHECKING:
    import pyarrow as pa

MANIFEST = "campaign.json"
_PART = re.compile(r"part-\d{6,}\.parquet")
_OF = b"kincal.campaign"  # in the metadata of a part: what its cases belong to
Row = dict[str, Any]


def row_of(plan: Plan, answer: Answer) -> Row:
    """A case as it is stored. The dispersed values are those of the world; of a case that died, those
    that were asked for."""
    case, found = answer.case, answer.answer
    outcome: Row = {"ended": "finished", "reason": ""} if plan.spec.function else dict.fromkeys(OUTCOME)
    if "error" in found:
        outcome |= {"ended": DIED, "reason": found["error"]}
        values, digest, cpu_s = case.changes, "", None
    else:
        outcome |= found["outcome"]
        values, digest, cpu_s = found["dispersed"], found["digest"], found["cpu_s"]
    drawn = {DISPERSED + key: values[key] for key in plan.keys}
    timings = {"wall_s": answer.wall_s, "cpu_s": cpu_s}
    return {"index": case.index, "seed": case.seed, **drawn, **outcome, "digest": digest, **timings}


def _joined(known: type, kind: type) -> type | None:
    """The type of a column that has values of both; None if there is none."""
    if kind in (known, type(None)):
        return known
    if known is type(None):
        return kind
    return float if {known, kind} == {int, float} else None


def fitting(answer: Answer, kinds: dict[str, type]) -> Answer:
    """The answer if its columns have the types of kinds, which learns new ones; else that the case died of
    it."""
    outcome = answer.answer.get("outcome", {})
    joined = {name: _joined(kinds.get(name, type(None)), type(value)) for name, value in outcome.items()}
    for name, kind in joined.items():
        if kind is None:
            given, known = type(outcome[name]).__name__, kinds[name].__name__
            why = f"TypeError: {name} is of type {given}, in other cases or as declared of type {known}"
            return replace(answer, answer={"index": answer.case.index, "error": why})
    kinds |= {name: kind for name, kind in joined.items() if kind is not None}
    return answer


def _same_declared(found: Mapping[str, type], declared: Mapping[str, type], where: str) -> None:
    """BadInput if columns have other types than those that are declared."""
    for name, kind in declared.items():
        given = found.get(name, type(None))
        if _joined(given, kind) is None:
            what = f"{name} is of type {given.__name__}, not {kind.__name__} as declared"
            raise BadInput(what, where, "change the function, or [columns] of the campaign")


def is_outcome(column: str) -> bool:
    """Whether it says what came of a case."""
    return column not in FIXED and not column.startswith(DISPERSED)


def _schema(plan: Plan, given: Mapping[str, type], of: bytes) -> pa.Schema:
    """given: columns of the outcome with their types."""
    import pyarrow as pa

    kinds = {str: pa.string(), bool: pa.bool_(), int: pa.int64(), float: pa.float64(), type(None): pa.null()}
    drawn = [(DISPERSED + key, kinds[type(law.choice[0]) if law.choice else float]) for key, law in plan.laws]
    return pa.schema(
        [
            *(("index", pa.int64()), ("seed", pa.int64())),
            *drawn,
            *((n, kinds[kind]) for n, kind in given.items()),
            *(("digest", pa.string()), ("wall_s", pa.float64()), ("cpu_s", pa.float64())),
        ],
        metadata={_OF: of},
    )


# ---- write


@dataclass
class Store:
    """The folder while cases are flown into it; only one process at a time."""

    folder: Path
    plan: Plan
    done: set[int] = field(default_factory=set)
    _lock: int = -1
    _next: int = 1
    _kinds: dict[str, type] = field(default_factory=dict)  # of the columns that a function gave
    _of: bytes = b""

    def __enter__(self) -> Store:
        """Open the folder, or make it. BadInput if it belongs to something else, or is in use."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(self.folder / ".lock", os.O_CREAT | os.O_RDWR)
        except OSError as error:
            raise BadInput(f"cannot be written: {error.strerror}", str(self.folder), "name another") from None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._open()
        except BlockingIOError:
            os.close(self._lock)
            todo = "wait for it, or end it; it loses nothing"
            raise BadInput("another process flies cases into this folder", str(self.folder), todo) from None
        except BaseException:
            os.close(self._lock)
            raise
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _value: BaseException | None, _tb: TracebackType | None
    ) -> None:
        os.close(self._lock)

    def _open(self) -> None:
        new = manifest_of(self.plan)
        if (self.folder / MANIFEST).exists():
            old = read_manifest(self.folder)
            if differing := _differences(old, new):
                lines = "; ".join(f"{what}: {was} there, {is_} here" for what, was, is_ in differing)
                raise BadInput(
                    f"the folder holds cases that were flown otherwise ({lines})",
                    str(self.folder),
                    "name another folder, or fly with what campaign.json there says",
                )
        elif parts(self.folder):
            raise BadInput(f"the folder has cases but no {MANIFEST}", str(self.folder), "name another folder")
        for left in (*self.folder.glob("part-*.parquet.tmp"), *self.folder.glob(f"{MANIFEST}.tmp")):
            left.unlink()  # begun by a process that was killed; nobody else's
        self._of = _belonging(new)
        self._kinds = kinds_of(self.folder)
        if self.plan.spec.function:
            _same_declared(self._kinds, self.plan.spec.outcome, str(self.folder))
        self.done = set(_indices(self.folder))
        self._next = max((int(part.stem.partition("-")[2]) for part in parts(self.folder)), default=0) + 1
        text = json.dumps(new, indent=1) + "\n"
        write_whole(self.folder / MANIFEST, text.encode())  # also where only requirements or titles are new

    def write(self, answers: Iterable[Answer]) -> int:
        """One part with these cases; how many of them died here, of a column with another type than that of
        other cases. CommandFailed if it cannot be written; then there is nothing of it."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        given = sorted(answers, key=lambda answer: answer.case.index)
        if not given:
            return 0
        kept, kinds = self._fitting(given) if self.plan.spec.function else (given, OUTCOME)
        rows = [row_of(self.plan, answer) for answer in kept]
        for name in (name for name, kind in kinds.items() if kind is float):  # also of a large whole number
            for row in rows:
                row[name] = None if row.get(name) is None else float(row[name])
        buffer = io.BytesIO()
        pq.write_table(pa.Table.from_pylist(rows, _schema(self.plan, kinds, self._of)), buffer)
        write_whole(self.folder / f"part-{self._next:06d}.parquet", buffer.getvalue())
        self._next += 1
        self.done.update(int(row["index"]) for row in rows)
        self._kinds |= kinds if self.plan.spec.function else {}
        return sum(is_ is not was for is_, was in zip(kept, given, strict=True))

    def _fitting(self, answers: list[Answer]) -> tuple[list[Answer], dict[str, type]]:
        """The answers as they are stored, and their columns with the types. BadInput if a column has nowhere
        the type that is declared."""
        declared = self.plan.spec.outcome
        kinds = dict(declared) | self._kinds
        kept = [fitting(answer, kinds) for answer in answers]
        outcomes = [answer.answer.get("outcome", {}) for answer in kept]
        for died in (was for is_, was in zip(kept, answers, strict=True) if is_ is not was):
            given = {name: type(value) for name, value in died.answer["outcome"].items()}
            unknown = {
                name for name in declared if all(o.get(name) is None for o in outcomes)
            } - self._kinds.keys()
            _same_declared(given, {n: declared[n] for n in unknown}, "the function of the campaign")
        here = dict.fromkeys(("ended", "reason", *(name for outcome in outcomes for name in outcome)))
        return kept, {name: kinds[name] for name in here}


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that it is there whole or not at all, also after a power cut. CommandFailed if the
    disk is full or fails."""
    temporary = path.with_name(path.name + ".tmp")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.rename(path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        todo = "make room, then give the same command again: it goes on with the cases that are missing"
        raise CommandFailed(
            f"{path.name} could not be written: {error.strerror}", str(path.parent), todo
        ) from None


# ---- what it belongs to


def manifest_of(plan: Plan) -> Row:
    """What campaign.json says."""
    return {
        "spec": plan.spec.model_dump(),
        "beside": str(plan.beside),
        "scenario": plan.scenario,
        "tables_folder": str(plan.tables),
        "tables": plan.crcs,
        "spec_sha256": plan.hash,
        "software": plan.software,
    }


def _belonging(manifest: Row) -> bytes:
    """What makes two cases of one index the same: spec and software."""
    of = json.dumps([manifest["spec_sha256"], manifest["software"]], sort_keys=True)
    return hashlib.sha256(of.encode()).hexdigest().encode()


def read_manifest(folder: Path) -> Row:
    """campaign.json of a folder. BadInput if there is none, or it is damaged."""
    path = folder / MANIFEST
    try:
        found: Row = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise BadInput(
            "no campaign here", str(folder), "`kincal campaign run SPEC --out FOLDER` makes one"
        ) from None
    except (OSError, ValueError) as error:
        raise BadInput(f"cannot be read: {error}", str(path)) from None
    if not isinstance(found, dict):
        raise BadInput("is no campaign's", str(path), "name a folder that `kincal campaign run` made")
    if (
        missing := {"spec", "beside", "scenario", "tables", "tables_folder", "spec_sha256", "software"}
        - found.keys()
    ):
        raise BadInput(
            f"has no {sorted(missing)[0]}", str(path), "name a folder that `kincal campaign run` made"
        )
    try:
        same = hash_of(contents_of(found["spec"], found["scenario"], found["tables"])) == found["spec_sha256"]
    except (AttributeError, KeyError, TypeError):
        same = False
    if not same:
        todo = "restore it; its cases belong to the file that it held"
        raise BadInput("has been changed since cases were flown", str(path), todo)
    return found


def plan_of(folder: Path) -> Plan:
    """The plan of a campaign that was flown, from its folder."""
    m = read_manifest(folder)
    doc = {key: value for key, value in m["spec"].items() if value is not None}
    doc["dispersion"] = [{k: v for k, v in law.items() if v is not None} for law in doc["dispersion"]]
    for law in doc["dispersion"]:  # JSON has no tuples, a file has none either: lists are read as both
        law.update({k: tuple(law[k]) for k in ("uniform", "normal", "limits") if k in law})
    spec = validate(Campaign, doc, str(folder / MANIFEST))
    return Plan(spec, Path(m["beside"]), m["scenario"], Path(m["tables_folder"]), m["tables"])


def _differences(old: Row, new: Row) -> list[tuple[str, str, str]]:
    found = [(k, old["software"].get(k, "nothing"), v) for k, v in new["software"].items()]
    found += [
        (f"table {kind}", old["tables"].get(folder, {}).get(kind, "none"), crc)
        for folder, kinds in new["tables"].items()
        for kind, crc in kinds.items()
    ]
    found += [("spec", old["spec_sha256"][:12], new["spec_sha256"][:12])]
    return [(what, was, is_) for what, was, is_ in found if was != is_]


def software_differences(folder: Path) -> list[str]:
    """What differs between the software here and that which flew a campaign."""
    there, here = read_manifest(folder)["software"], plan_of(folder).software
    return [
        f"{what}: {there.get(what)} there, {here[what]} here"
        for what in here
        if there.get(what) != here[what]
    ]


# ---- read


def parts(folder: Path) -> list[Path]:
    """The parts, in the order in which they were written."""
    return sorted(part for part in folder.glob("part-*.parquet") if _PART.fullmatch(part.name))


def _tables(folder: Path, columns: list[str] | None = None) -> Iterator[pa.Table]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    todo = "remove this part; `kincal campaign run` flies its cases again"
    expected = _belonging(read_manifest(folder)) if parts(folder) else b""
    for part in parts(folder):
        try:
            table = pq.read_table(part, columns=columns)
        except (OSError, pa.ArrowException) as error:
            raise BadInput(f"cannot be read: {error}", str(part), todo) from None
        # parts of versions that wrote no such word have none
        if (table.schema.metadata or {}).get(_OF, expected) != expected:
            raise BadInput("holds cases of another campaign or other software", str(part), todo)
        yield table


def kinds_of(folder: Path) -> dict[str, type]:
    """Columns of the outcome that the parts have, with their types. BadInput if one has several."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {pa.string(): str, pa.bool_(): bool, pa.int64(): int, pa.float64(): float}
    found: dict[str, type] = {}
    for part in parts(folder):
        for column in (column for column in pq.read_schema(part) if is_outcome(column.name)):
            known = found.get(column.name, type(None))
            joined = _joined(known, kinds.get(column.type, type(None)))
            if joined is None:
                what = f"{column.name} is of type {known.__name__} in one part, {column.type} in another"
                raise BadInput(what, str(folder), "fly the campaign into another folder")
            found[column.name] = joined
    return found


def _with_floats(table: pa.Table, kinds: Mapping[str, type]) -> pa.Table:
    """The table with floats in the columns that have floats in other parts."""
    import pyarrow as pa

    for number, column in enumerate(table.schema):
        if kinds.get(column.name) is float and column.type == pa.int64():
            floats = table[column.name].cast(pa.float64(), safe=False)  # not only up to 2^53
            table = table.set_column(number, column.name, floats)
    return table


def _indices(folder: Path) -> list[int]:
    found = [index for table in _tables(folder, ["index"]) for index in table["index"].to_pylist()]
    if len(set(found)) != len(found):
        raise BadInput("a case is there twice", str(folder), "remove one of the parts that hold it")
    return found


@dataclass(frozen=True)
class Results:
    """The cases of a campaign so far, by columns, in the order of their indices. plan: what was to be flown;
    software: what flew it."""

    folder: Path
    plan: Plan
    software: dict[str, str]
    columns: dict[str, list[Any]]

    @property
    def n(self) -> int:
        """How many cases."""
        return len(self.columns["index"])

    def outcomes(self) -> Iterator[Row]:
        """The outcome of every case, as conditions take it."""
        names = [name for name in self.columns if is_outcome(name)]
        for values in zip(*(self.columns[name] for name in names), strict=True):
            yield dict(zip(names, values, strict=True))

    def row(self, index: int) -> Row:
        """A case by its index. BadInput if it has not been flown."""
        try:
            k = self.columns["index"].index(index)
        except ValueError:
            todo = f"name one from 0 to {self.plan.spec.cases - 1} that was flown"
            raise BadInput(f"there is no case {index}", str(self.folder), todo) from None
        return {name: values[k] for name, values in self.columns.items()}


def read(folder: Path) -> Results:
    """The cases of its campaign that a folder holds. BadInput if it holds none, or is damaged."""
    import pyarrow as pa
    import pyarrow.compute as pc

    m, plan = read_manifest(folder), plan_of(folder)
    _indices(folder)
    kinds = kinds_of(folder)
    if not (found := [_with_floats(table, kinds) for table in _tables(folder)]):
        raise BadInput("no case has been flown yet", str(folder), "`kincal campaign run` flies them")
    table = pa.concat_tables(found, promote_options="permissive").sort_by("index")
    table = table.filter(pc.field("index") < plan.spec.cases)
    return Results(
        folder, plan, m["software"], {name: table[name].to_pylist() for name in table.column_names}
    )
