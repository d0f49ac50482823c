"""Driver variables in words that need no glossary, for axes."""

from __future__ import annotations

import re
import textwrap

from kincal.workbench.model.unnamed_names import GRAVITY, HEADINGS, OF_ORIENTATION, TOOL_AXES
from kincal.workbench.report import explain
from kincal_shared.schema.names import FAULTS, LEVER_STRIDE, PNP, VARIABLES

HEADING = "heading of the tool"
"""All headings together."""

_TITLE = 34  # characters of a line under one of four panels side by side
_INDEXED = re.compile(r"(?P<kind>[a-z]+?)(?P<number>\d+)(?P<rest>.*)", re.S)
_LEVER = re.compile(r"lev(?P<axis>[xyz])")


def driver(name: str) -> str:
    """A driver variable; what follows its name ("modulo 0.46") stays. q3 stays as it is."""
    if name in OF_ORIENTATION:
        return explain.in_words(name)
    variable, _, rest = name.partition(" ")
    return f"{_driver(variable)} {rest}".rstrip()


def _driver(variable: str) -> str:
    m = _INDEXED.fullmatch(variable)
    if m and _LEVER.fullmatch(m["kind"]):
        return _lever(m["kind"][-1], int(m["number"]))
    if m and m["kind"] in PNP:
        return _fault(m["kind"], int(m["number"]))
    return explain.in_words(variable)


def _lever(axis: str, index: int) -> str:
    """levz39: the frame of link 2 carries joint 3, the body is link 7; body 0 is the tool."""
    link, body = divmod(index, LEVER_STRIDE)
    what = f"link {body}" if body else "tool"
    if axis == "z":
        return f"gravity lever of {what} at joint {link + 1}"
    return f"gravity lever of {what} about {axis} of link {link}"


def _fault(kind: str, index: int) -> str:
    """prx1: what a unit of the first fault of the camera or the target does to the pose, about x."""
    move = "turn about" if kind[1] == "r" else "shift along"
    return f"{move} {kind[-1]} by {FAULTS[index - 1].replace('_', ' ')}"


def axis(name: str, unit: str | None = None) -> str:
    """A driver variable with its unit; unit: where the caller knows it better (of a prismatic joint)."""
    if name in HEADINGS:
        return f"{driver(name)} [rad]"
    if name in OF_ORIENTATION:  # a direction, of which one component is drawn
        of = "" if name in (*TOOL_AXES, GRAVITY) else " of the tool's z axis"
        return f"{driver(name)}, z component{of}"
    said = _unit(name) if unit is None else unit
    return f"{driver(name)} [{said}]" if said else driver(name)


def title(name: str) -> str:
    """Title of the axis of a driver variable under a small panel: in lines, or it covers its neighbours'."""
    whole = re.sub(r"\[.*\]", lambda unit: unit[0].replace(" ", "\N{NO-BREAK SPACE}"), axis(name))
    return "<br>".join(textwrap.wrap(whole, _TITLE))


def _unit(name: str) -> str:
    m = _INDEXED.fullmatch(name)
    kind = m["kind"] if m else name
    if kind == "q":
        return "rad"
    unit = VARIABLES[kind].unit if kind in VARIABLES else ""
    return "" if unit == "1" else unit
