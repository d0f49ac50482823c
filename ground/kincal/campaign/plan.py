"""The file of a campaign with all that it refers to, checked; and the cases that it makes.

A case is a function of the root seed and its index: its seed and, with random sampling, its values come from
SeedSequence(root, spawn_key=(index, ...)), so that nothing depends on order, processes or interruptions."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import qmc

from kincal.results import Value
from kincal.run import dispersed
from kincal.run.dispersed import TABLES_KEY
from kincal.run.inprocess import TABLES
from kincal_shared.errors import BadInput
from kincal_shared.schema.campaign import Campaign, Dispersion, expanded, read_campaign

from . import function

Floats = NDArray[np.float64]
_SEED, _VALUES, _SEQUENCE = 0, 1, 2  # last number of a spawn key: what the random numbers are for
_END = 2.0**-33  # values of a sequence stay away from 0 and 1, where a normal distribution is infinite
_INSIDE = 0.381966  # of a range: a value that is no end, for what takes whole numbers only
_SIGMAS = 4.0  # so far out a normal distribution without limits is checked


@dataclass(frozen=True)
class Case:
    """One case. changes: value of every key that differs from the scenario."""

    index: int
    seed: int
    changes: dict[str, Value]


@dataclass(frozen=True)
class Plan:
    """A campaign ready to fly. spec: its file; beside: the folder of that; scenario: the whole scenario as
    plain values, empty with a function; tables: folder with table images; crcs: theirs, and of the other
    folders that are dispersed."""

    spec: Campaign
    beside: Path
    scenario: dict[str, Any]
    tables: Path
    crcs: dict[str, dict[str, str]]

    @cached_property
    def laws(self) -> tuple[tuple[str, Dispersion], ...]:
        """Dispersed keys with their distributions, in the order of the file."""
        return tuple((key, law) for law in self.spec.dispersion for key in expanded(law.key))

    @property
    def keys(self) -> tuple[str, ...]:
        """What differs from case to case."""
        return tuple(key for key, _ in self.laws)

    def contents(self) -> dict[str, Any]:
        """Everything that the cases depend on, besides the software. Titles, requirements with their columns
        and the place of the tables are not part of it, nor is how many there are, where no case depends on
        that."""
        return contents_of(self.spec.model_dump(), self.scenario, self.crcs)

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the contents."""
        return hash_of(self.contents())

    @property
    def software(self) -> dict[str, str]:
        """Everything else that they depend on."""
        return function.software(self.spec.function, self.beside)

    @cached_property
    def combinations(self) -> int:
        """How many combinations of choices there are."""
        return prod(len(law.choice or ()) for _, law in self.laws)

    def seed(self, index: int) -> int:
        """Seed of a case: flight takes 31 bits. Combinations that are compared have the same."""
        if self.spec.sampling == "combinations":
            return self.spec.seed + index // self.combinations
        sequence = np.random.SeedSequence(self.spec.seed, spawn_key=(index, _SEED))
        return int(sequence.generate_state(1)[0] >> 1)

    @cached_property
    def _sequence(self) -> Floats:
        """(cases, keys) points of the whole campaign between 0 and 1, for those that are drawn together."""
        n, d = self.spec.cases, len(self.laws)
        rng = np.random.default_rng(np.random.SeedSequence(self.spec.seed, spawn_key=(0, _SEQUENCE)))
        if self.spec.sampling == "sobol":
            return np.array(qmc.Sobol(d, rng=rng).random_base2(n.bit_length() - 1), float)
        return np.array(qmc.LatinHypercube(d, rng=rng).random(n), float)

    def _point(self, index: int) -> Floats:
        if self.spec.sampling == "random":
            sequence = np.random.SeedSequence(self.spec.seed, spawn_key=(index, _VALUES))
            return np.random.default_rng(sequence).random(len(self.laws))
        point: Floats = self._sequence[index]
        return point

    def case(self, index: int) -> Case:
        """A case by its index, from 0."""
        if self.spec.sampling == "combinations":
            choices = [law.choice or [] for _, law in self.laws]
            at = np.unravel_index(index % self.combinations, [len(choice) for choice in choices])
            chosen = {key: choice[int(k)] for key, choice, k in zip(self.keys, choices, at, strict=True)}
            return Case(index, self.seed(index), {**self.spec.set, **chosen})
        point = np.clip(self._point(index), _END, 1.0 - _END)
        drawn = {key: _value(law, float(u)) for (key, law), u in zip(self.laws, point, strict=True)}
        return Case(index, self.seed(index), {**self.spec.set, **drawn})

    def cases(self, indices: Iterable[int]) -> Iterator[Case]:
        """Cases by their indices."""
        return (self.case(index) for index in indices)

    def for_worker(self) -> dict[str, Any]:
        """What a process needs to know that flies cases."""
        return {
            "function": self.spec.function,
            "beside": str(self.beside),
            "scenario": self.scenario,
            "tables": str(self.tables),
            "software": self.software,
        }


def contents_of(
    spec: Mapping[str, Any], scenario: Mapping[str, Any], crcs: Mapping[str, Any]
) -> dict[str, Any]:
    """Contents of a plan from plain values, such as those of campaign.json."""
    out = {"title", "requirement", "columns", "tables", "scenario"}
    out |= {"cases"} if spec["sampling"] in ("random", "combinations") else set()
    of_spec = {k: v for k, v in spec.items() if k not in out}
    of_scenario = {k: v for k, v in scenario.items() if k not in ("name", "title", "expect")}
    contents: dict[str, Any] = json.loads(
        json.dumps({"spec": of_spec, "scenario": of_scenario, "tables": crcs})
    )
    return contents


def hash_of(contents: Mapping[str, Any]) -> str:
    """SHA-256 of contents."""
    return hashlib.sha256(json.dumps(contents, sort_keys=True).encode()).hexdigest()


def _value(law: Dispersion, u: float) -> Value:
    if law.choice is not None:
        return law.choice[min(int(u * len(law.choice)), len(law.choice) - 1)]
    if law.uniform is not None:
        low, high = law.uniform
        return low + u * (high - low)
    assert law.normal is not None
    mean, sigma = law.normal
    if law.limits is None:
        return float(stats.norm.ppf(u, mean, sigma))
    low, high = ((end - mean) / sigma for end in law.limits)
    return float(stats.truncnorm.ppf(u, low, high, mean, sigma))


def prepare(path: Path) -> Plan:
    """Read a campaign and everything that it refers to. BadInput says what is wrong, and where."""
    return planned(read_campaign(path), path)


def planned(spec: Campaign, path: Path) -> Plan:
    """A campaign with everything that it refers to. path: the file that it is from. BadInput as above."""
    beside = path.parent.resolve()
    key = "function" if spec.function else "scenario"
    try:
        if spec.function:
            function.load(spec.function, beside)
        scenario = {} if spec.function else dispersed.load(spec.scenario, beside)
    except BadInput as error:
        raise BadInput(error.what, f"{path}: {key}", error.todo) from None
    folder = dispersed.tables_of(beside / spec.tables if spec.tables else TABLES)
    spec = _with_folders(spec, beside)
    crcs = {name: dispersed.crcs(Path(name or folder)) for name in ("", *_folders(spec))}
    plan = Plan(spec, beside, scenario, folder, crcs)
    if not spec.function:
        _check(plan, path)
    return plan


def _folders(spec: Campaign) -> list[str]:
    chosen = [str(v) for law in spec.dispersion if law.key == TABLES_KEY for v in law.choice or []]
    return chosen + ([str(spec.set[TABLES_KEY])] if TABLES_KEY in spec.set else [])


def _with_folders(spec: Campaign, beside: Path) -> Campaign:
    """The same with absolute paths of table folders."""

    def absolute(value: Any) -> str:
        return str(dispersed.tables_of(beside / str(value)))

    laws = [
        law.model_copy(update={"choice": [absolute(v) for v in law.choice or []]})
        if law.key == TABLES_KEY
        else law
        for law in spec.dispersion
    ]
    fixed = {k: absolute(v) if k == TABLES_KEY else v for k, v in spec.set.items()}
    return spec.model_copy(update={"dispersion": laws, "set": fixed})


def _check(plan: Plan, path: Path) -> None:
    """What is set, and the ends of every range, can be built. One at a time: they do not depend on each
    other."""
    _try(plan, dict(plan.spec.set), f"{path}: set")
    for number, law in enumerate(plan.spec.dispersion, 1):
        for key in expanded(law.key):
            for value in _ends(law):
                try:
                    _try(
                        plan, {**plan.spec.set, key: value}, f"{path}: dispersion[{number}], {key} = {value}"
                    )
                except BadInput as error:
                    todo = error.todo
                    if law.normal is not None and law.limits is None:
                        todo = (
                            f"a normal distribution reaches there: add limits = [LOW, HIGH]. {todo}".strip()
                        )
                    raise BadInput(error.what, error.where, todo) from None


def _ends(law: Dispersion) -> list[Value]:
    if law.choice is not None:
        return list(law.choice)
    ends = law.uniform or law.limits
    if ends is None:
        assert law.normal is not None
        mean, sigma = law.normal
        ends = (mean - _SIGMAS * sigma, mean + _SIGMAS * sigma)
    low, high = ends
    return [low, high, low + _INSIDE * (high - low)]


def _try(plan: Plan, changes: dict[str, Value], where: str) -> None:
    try:
        dispersed.changed(plan.scenario, changes)
        with dispersed.tables_with(Path(str(changes.get(TABLES_KEY, plan.tables))), changes):
            pass
    except BadInput as error:
        raise BadInput(error.what, where, error.todo) from None
