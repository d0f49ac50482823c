"""What to do after a diagnosis, as commands to copy."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from kincal.schema.names import UNNAMED

from . import explain
from .diagnosis import Diagnosis
from .nextposes import NextPose

_NEW_MODEL = "M.toml"
_CALIBRATED = "calibrated.toml"
_NAMED = 8  # outliers in a command


@dataclass(frozen=True)
class Inputs:
    """What a command was given, as words of a command line: the arm, the options that say the data, and the
    model file (empty if none)."""

    arm: str
    data: tuple[str, ...]
    model: str = ""

    @property
    def sources(self) -> tuple[str, ...]:
        """Arm and data."""
        return ("--arm", self.arm, *self.data)


@dataclass(frozen=True)
class Step:
    """Something to do: why, and the command for it."""

    why: str
    command: str


def next_steps(d: Diagnosis, poses: Sequence[NextPose], inputs: Inputs) -> tuple[Step, ...]:
    """The commands that follow from a diagnosis, most useful first."""
    return (*_adding(d, inputs), *_measuring(poses, inputs), *_excluding(d, inputs))


def _kincal(*words: str) -> str:
    return "kincal model " + " ".join(map(shlex.quote, words))


def _adding(d: Diagnosis, inputs: Inputs) -> Iterator[Step]:
    names = [e.name for e in d.effects if e.in_model]
    model = ("--model", inputs.model or _NEW_MODEL)
    if names:
        yield Step("add what was found to the model", _kincal("add", *model, *names))
    smooth = d.novel is not None and not d.exhausted
    if smooth:
        yield Step(
            "add smooth functions for what has no name, as many as predict better",
            _kincal("add", *model, *inputs.sources, UNNAMED),
        )
    if names or smooth or inputs.model or d.verdict == "adequate":
        yield Step("fit it and see what each effect brings", _kincal("fit", *inputs.sources, *model))
        words = (*model, "--format", "dh", "-o", _CALIBRATED)
        yield Step("take the calibrated arm away (also urdf, python, c)", _kincal("export", *words))


def _measuring(poses: Sequence[NextPose], inputs: Inputs) -> Iterator[Step]:
    if poses:
        model = ("--model", inputs.model) if inputs.model else ()
        names = poses[0].separates
        why = f"poses that separate {explain.listed(names)}"
        yield Step(why, _kincal("next", *inputs.sources, *model, *names))


def _excluding(d: Diagnosis, inputs: Inputs) -> Iterator[Step]:
    ids = d.comparison.outliers.ids
    if ids and len(ids) <= _NAMED:
        model = ("--model", inputs.model) if inputs.model else ()
        words = (*inputs.sources, *model, "--exclude", ",".join(ids))
        yield Step("look at the outliers; without them", _kincal("diagnose", *words))
