"""What the workbench's results mean, in sentences that people read."""

from __future__ import annotations

import math

from .adequacy import Outliers
from .compare import Comparison
from .diagnosis import Diagnosis, EffectFinding
from .diagnosis.suggestions import Suggestion
from .hypotheses import Untestable, effect_of, place_of
from .nested import NoGain

VERDICTS = {
    "adequate": "Nothing is missing that these data could show.",
    "effect": "One effect is missing.",
    "several_effects": "Several effects are missing.",
    "novel": "Something is missing that no effect of the library describes.",
    "undecidable": "Something is missing, but these data do not determine what: "
    "see the alternatives and the next poses.",
}
_DRIVERS = {
    "t": "time",
    "order": "order in which the poses were taken",
    "temp": "temperature",
    "payload": "payload",
    "tag": "tag that was seen",
    "zcam": "distance along the line of sight",
    "u": "image position, across",
    "v": "image position, down",
    "r2": "distance from the image centre, squared",
    "incid": "incidence angle",
    "pan": "pan of the camera",
    "tilt": "tilt of the camera",
    "sx": "tool position x",
    "sy": "tool position y",
    "sz": "tool position z",
}
_JOINT_DRIVERS = {"tau": "gravity torque", "dir": "approach direction", "qdot": "velocity"}


def in_words(variable: str) -> str:
    """A driver variable: tau2 -> gravity torque of joint 2; joint angles and unknown names stay."""
    kind = variable.rstrip("0123456789")
    if kind in _JOINT_DRIVERS and kind != variable:
        return f"{_JOINT_DRIVERS[kind]} of joint {variable[len(kind) :]}"
    return _DRIVERS.get(variable, variable)


def why(e: EffectFinding) -> str:
    """One sentence about what speaks for an effect, and what restricts that."""
    gain = "no held-out poses"
    if math.isfinite(e.held.after_m):
        gain = f"held-out error {e.held.before_m * 1e3:.3f} to {e.held.after_m * 1e3:.3f} mm"
    text = (
        f"consistent with {e.label}: its pattern explains {e.explained_share:.0%} of what the model "
        f"without it leaves, {gain}, probability {e.probability:.2f}"
    )
    if e.helps:
        text += "; something unnamed explains more, but held-out poses gain"
    if e.capped:
        text += "; the model with it does not explain the data yet, so it is not identified"
    return text


def suggestion(s: Suggestion) -> str:
    """A term to try, as a line of an effect file."""
    if not s.basis:
        return f'at = "{s.at}", a function of {s.driver}'
    component = f', comp = "{s.comp}"' if s.comp else ""
    return f'at = "{s.at}"{component}, basis = "{s.basis}"'


def no_gain(n: NoGain) -> str:
    """An effect that held-out poses do not gain from."""
    low, high = n.interval
    numbers = f"held-out error ratio {n.ratio:.3f} (95 % interval {low:.3f} to {high:.3f})"
    if n.helps is False:
        return f"{n.effect} does not help on {n.block}: {numbers}"
    return f"whether {n.effect} helps on {n.block} these poses cannot tell: {numbers}"


def outlier_note(o: Outliers) -> str:
    """Empty unless the outliers cluster."""
    if not o.clusters:
        return ""
    return f"the outliers cluster in {', '.join(o.clusters)}: that is an effect rather than bad poses"


def notes(c: Comparison) -> list[str]:
    """What else a reader of a comparison should know."""
    return [f"joint {j} does not move in these data: its errors cannot be estimated" for j in c.still_joints]


def not_testable(n: Untestable) -> str:
    """Why an effect could not be tested."""
    absorbed = "absorbed by the fitted parameters (DH, base, tool)"
    return f"{n.name}: {'needs ' + ', '.join(n.needs) if n.needs else absorbed}"


def verdict(d: Diagnosis) -> str:
    """The diagnosis in one sentence."""
    return VERDICTS[d.verdict]


def grouped(names: tuple[str, ...]) -> str:
    """Effect names, places of one effect together: gain[1], gain[2], flex -> gain[1], [2]; flex."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(effect_of(name), []).append(place_of(name))
    return "; ".join(effect + ", ".join(places) for effect, places in groups.items())
