"""What the workbench's results mean, in sentences that people read."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

from ..comparison.compare import Comparison
from ..comparison.fitting import FitResult
from ..data.direction import in_random_order
from ..data.measurements import Measurements
from ..diagnosis import Diagnosis, EffectFinding, HeldGain, ParameterValue, UnnamedFinding
from ..diagnosis.findings import LIKELY, fitted_values
from ..diagnosis.suggestions import Suggestion
from ..evidence.adequacy import REPLICATES, STATED, STRUCTURE_P, UNKNOWN, NoiseFloor, Outliers, TurnedFrame
from ..evidence.neighbours import Alike
from ..evidence.serial import Serial
from ..fit.least_squares import Fit
from ..fit.length_scale import LengthScale
from ..model import sight
from ..model.hypotheses import Untestable, effect_of, joints_of, place_of
from ..model.unnamed_names import HEADINGS, SENSOR_AXES, UnnamedName
from ..numerics.distributions import chi2_tail
from ..prediction.gain import much_worse
from ..prediction.nested import CROSSED, EffectGain, NestedModels
from ..prediction.nextposes import NextPose, poses_to_decide
from ..prediction.reachable import Reachable

_NOISIER, _CHANCE = 1.1, 1e-3  # times the stated noise that is said, and p-value of it
_CLAIMED = 0.9  # probability from which on an effect, or one of several, is there
_ONE_NAME = 0.8  # probability of a name from which on no other is said beside it

_DRIVERS = {
    "t": "time",
    "order": "order of measurement",
    "temp": "temperature",
    "payload": "payload",
    "tag": "tag seen",
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
    "orientation": "tool orientation",
    "tool_x": "direction of the tool's x axis",
    "tool_y": "direction of the tool's y axis",
    "tool_z": "direction of the tool's z axis",
    "gravity": "gravity in the tool frame",
    "tool_move": "last move of the tool",
}
_JOINT_DRIVERS = {
    "tau": "gravity torque",
    "dir": "approach direction",
    "move": "last move",
    "qdot": "velocity",
}
_NEAR = {"orientation": "orientation of the tool", "all joints": "all joint angles"}
_NO_ARTICLE = ("time", "temperature", "tool position", "gravity in")  # of what is said of them in words
_SLOW = {"t", "order", "temp"}  # what only these change drifts
_AT = {
    "base rotation": "base orientation",
    "base translation": "base position",
    "tool rotation": "tool orientation on the flange",
    "tool translation": "tool position on the flange",
    "camera rotation": "camera orientation",
    "camera translation": "camera position",
    "tag rotation": "tag orientation",
    "tag tilt": "measured tilt of the tag",
    "measured orientation": "measured orientation",
    "measured pose": "measured pose",
    "range": "measured range",
}
_BLOCKS = {
    "unseen region": "the unseen region",
    "time block": "the held-out time block",
    "direction": "the held-out approach direction",
    CROSSED: "poses held out in turns",
}


def in_words(variable: str) -> str:
    """A driver variable: tau2 -> gravity torque of joint 2; joint angles and unknown names stay."""
    if variable in HEADINGS:
        axis, about, periods = HEADINGS[variable]
        return f"heading of {_axis(axis)} about {_axis(about)}, {periods} periods a turn"
    kind = variable.rstrip("0123456789")
    if kind in _JOINT_DRIVERS and kind != variable:
        return f"{_JOINT_DRIVERS[kind]} of joint {variable[len(kind) :]}"
    return _DRIVERS.get(variable, variable)


def _in_sentence(variable: str) -> str:
    """A driver variable inside a sentence: the gravity torque of joint 2."""
    text = in_words(variable)
    return text if text == variable or text.startswith(_NO_ARTICLE) else f"the {text}"


def _axis(name: str) -> str:
    """tool_x: the tool's x axis."""
    of, _, axis = name.partition("_")
    return f"the {of}'s {axis} axis"


def _error_at(location: str) -> str:
    """What is wrong where an error enters: the error of joint 2, the tilt of link 3, the base position."""
    if location.startswith("link"):
        return f"the tilt of {location.removesuffix(' tilt')}"
    return f"the {_AT[location]}" if location in _AT else f"the error of {location}"


def percent(share: float) -> str:
    """A share as a whole number of percent."""
    return f"{100 * share:.0f} %"


def in_block(name: str) -> str:
    """The poses of a block of nested models, inside a sentence."""
    return _BLOCKS.get(name, name)


def why(e: EffectFinding) -> str:
    """One sentence about what speaks for an effect, and what restricts that. A probability is said only of
    what won or competes by it."""
    text = (
        f"consistent with {e.label}{_or_confounded(e)}: its pattern explains "
        f"{percent(e.explained_share)} of the residual of the model without it, {held_gain(e.held)}"
    )
    if e.role == "helps":
        text += f"; something unnamed explains more, but {only_predicts(e)}"
    else:
        text += f", probability {e.probability:.2f}{doubts(e)}"
    if e.harms:
        text += "; it harms: not in the model"
    elif e.taken_back or e.doubts.worse:
        text += f"; {not_confirmed(e)}"
    if e.inferred_direction:
        text += "; approach direction inferred from the order of measurement"
    if against_nature := negative(e.parameters):
        text += f"; {against_nature}"
    return text


def negative(values: Sequence[ParameterValue], effect: str = "") -> str:
    """Values that are negative though nature has positive ones only, and what to check; empty if there are
    none. effect: its name, if it is to be said."""
    meant: dict[str, list[str]] = {}
    for p in values:
        if p.wrong_sign:
            meant.setdefault(p.if_negative, []).append(p.name)
    of = f" of {effect}" if effect else ""
    return "; ".join(
        f"{listed(names)}{of} {'is' if len(names) == 1 else 'are'} negative: {text}"
        for text, names in meant.items()
    )


def all_negative(fit: Fit) -> list[str]:
    """The same of all effects of a fit."""
    return [said for h in fit.hypotheses if (said := negative(fitted_values(h, fit), h.name))]


def is_confounded(e: EffectFinding) -> bool:
    """These data leave open whether it is this effect or one that it is confounded with."""
    return bool(e.confounded_with) and e.doubts.identity < _ONE_NAME


def _or_confounded(e: EffectFinding) -> str:
    """What may be meant as well, where these data leave that open."""
    if not is_confounded(e):
        return ""
    return f" or with what these data cannot tell from it ({grouped(e.confounded_with)})"


def doubts(e: EffectFinding) -> str:
    """What a probability is the product of, where evidence alone does not count; empty where it does."""
    d = e.doubts
    if d.support == d.identity == 1.0:
        return ""
    return (
        f" = {d.evidence:.2f} (evidence) x {d.support:.2f} (helps on poses that were not fitted) x "
        f"{d.identity:.2f} (is what its name says)"
    )


def held_gain(gain: HeldGain) -> str:
    """What held-out poses say of an effect: errors without and with it, their ratio, and the judgement."""
    if not math.isfinite(gain.after_m):
        return "no held-out poses"
    kind = "cross-validated" if gain.cross_validated else "held-out"
    low, high = gain.interval
    turned = "" if gain.rotation is None else f", rotation ratio {gain.rotation:.3f}"
    return (
        f"{kind} error {gain.before_m * 1e3:.3f} to {gain.after_m * 1e3:.3f} mm, ratio "
        f"{gain.after_m / gain.before_m:.3f} (95 % interval {low:.3f} to {high:.3f}){turned}: "
        f"{gain.judged}"
    )


def smooth_gain(u: UnnamedFinding) -> str:
    """What poses that were not fitted say of the function of something unnamed. One of the tool's orientation
    may concern the rotations alone: both errors are said, and no judgement on positions."""
    gain = u.held
    if not UnnamedName.parse(u.name).without_terms or not math.isfinite(gain.after_m):
        return held_gain(gain)
    turned = "" if gain.rotation is None else f", rotation error times {gain.rotation:.3f}"
    return f"cross-validated error {gain.before_m * 1e3:.3f} to {gain.after_m * 1e3:.3f} mm{turned}"


def probability(p: float) -> str:
    """A probability that never claims to be 0 or 1."""
    if p < 0.01:
        return "P < 0.01"
    if p < LIKELY and f"{p:.2f}" == f"{LIKELY:.2f}":
        return f"P < {LIKELY:.2f}"
    return "P > 0.99" if p > 0.99 else f"P = {p:.2f}"


def not_confirmed(e: EffectFinding) -> str:
    """Why an effect that won was taken back."""
    if e.doubts.worse:
        return f"it makes {listed([*map(in_block, e.doubts.worse)])} much worse: not in the model"
    if e.helps:
        return (
            "others gain from it beside the final model, but did not beside what it was found with: not in "
            "the model"
        )
    return "the evidence is that of fitted poses, and others do not confirm it: not in the model"


def odds(e: EffectFinding, d: Diagnosis) -> str:
    """The probability of an effect with what it is against; of one that did not win only a small one, and why
    it is in the model in spite of it."""
    if e.role == "helps" and e.probability < LIKELY:
        return f"{only_predicts(e)}, whatever its cause ({probability(e.probability)} that it is this effect)"
    if e.role == "helps":
        return ""
    return f"{probability(e.probability)} {against(e, d)}"


def only_predicts(e: EffectFinding) -> str:
    """What an effect is in the model for that did not win."""
    return "it improves held-out poses" if e.helps and not e.held.cross_validated else (
        "it improves cross-validation"
    )  # fmt: skip


def against(e: EffectFinding, d: Diagnosis) -> str:
    """What the probability of an effect is against; empty where held-out poses decided."""
    if e.role == "helps":
        return ""
    return 'against "nothing missing" and unnamed effects' if e.accepted else _competitor(d)


def _competitor(d: Diagnosis) -> str:
    accepted = [x.name for x in d.effects if x.accepted]
    if accepted:
        return f"in place of {listed(accepted) if len(accepted) < 3 else 'the added effects'}"
    if d.novel is not None:
        return f"against an unnamed effect ({probability(d.novel.probability)})"
    return f'against "nothing missing" ({probability(d.probability_none)})'


def listed(names: Sequence[str]) -> str:
    """a; a and b; a, b and c."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def suggestion(s: Suggestion) -> str:
    """A term to try, as a line of an effect file."""
    if not s.basis:
        return f'at = "{s.at}", a function of {s.driver}'
    component = f', comp = "{s.comp}"' if s.comp else ""
    return f'at = "{s.at}"{component}, basis = "{s.basis}"'


def no_gain(n: EffectGain) -> str:
    """An effect that held-out poses do not show to help, by its interval."""
    low, high = n.interval
    verb = "is undecided" if n.judged == "undecided" else n.judged
    return (
        f"{n.effect} {verb} on {in_block(n.block)}: error of the whole model / error without it "
        f"{n.ratio:.3f} (95 % interval {low:.3f} to {high:.3f})"
    )


def not_recommended(nested: NestedModels) -> list[str]:
    """Effects that a fit speaks against, each with the blocks where it does harm; empty if there are none."""
    return [
        f"NOT recommended: {name}: {harms(nested.against, name)}; "
        "leave it out, or measure more poses where it fails"
        for name in nested.not_recommended
    ]


def harms(against: Sequence[EffectGain], name: str) -> str:
    """Where an effect does harm, and how much."""
    return "; ".join(_harm(g) for g in against if g.effect == name)


def _harm(g: EffectGain) -> str:
    if much_worse(g.interval) or g.rotation is None or not much_worse(g.rotation[1]):
        change = f"{g.before_m * 1e3:.3f} to {g.after_m * 1e3:.3f} mm"
        return f"it increases the error of {in_block(g.block)} from {change}"
    low, high = g.rotation[1]
    return (
        f"it multiplies the rotation error of {in_block(g.block)} by {g.rotation[0]:.2f} "
        f"(95 % interval {low:.2f} to {high:.2f})"
    )


def of_session(fit: Fit) -> list[str]:
    """Effects that other data are predicted with as they were in the end; empty where there are none."""
    names = fit.of_session
    if not names:
        return []
    follow, they = ("follow", "they were") if len(names) > 1 else ("follows", "it was")
    to_end = f"for other data it counts what {they} in the end"
    return [f"{listed(names)} {follow} the time of this session: {to_end}"]


def of_order(fit: Fit) -> list[str]:
    """Effects that no single pose shows; empty where there are none."""
    names = [h.name for h in fit.hypotheses if h.follows("move")]
    if not names:
        return []
    depend, them = ("depend", "them") if len(names) > 1 else ("depends", "it")
    return [
        f"{listed(names)} {depend} on the pose before: only poses in the order of measurement can be "
        f"predicted with {them}; an arm that waits until it is at rest does not have {them}"
    ]


def searched(f: FitResult) -> list[str]:
    """Constants that the poses chose, and those with which held-out ones are predicted where they differ."""
    return [
        f"{name}: {_constants(mine)}"
        + ("" if held == mine else f"; held-out poses are predicted with {_constants(held)}, which they did "
           "not choose")
        for name, (mine, held) in f.searched.items()
    ]  # fmt: skip


def _constants(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:.9g}" for name, value in values.items())


_MOST_POSES = 1000  # more is no advice
_FAR_BELOW = 0.05  # of the known noise: no fit leaves so little
_FAR_BEYOND = 1.5  # times a known noise that is said in the verdict


def cannot_decide(poses: Sequence[NextPose]) -> bool:
    """No number of such poses that anybody would measure tells the effects apart."""
    return poses_to_decide(poses) > _MOST_POSES


def would_not_decide(poses: Sequence[NextPose]) -> str:
    """What to do where next poses would hardly tell the effects apart."""
    more = poses_to_decide(poses)
    many = f"not even {_MOST_POSES}" if cannot_decide(poses) else f"about {more}"
    few = "1 more pose is" if len(poses) == 1 else f"{len(poses)} more poses are"
    return (
        f"{few} not enough (power {poses[-1].power:.2f}); {many} would give an even chance; inspecting the "
        "arm settles it: see the inspect lines of `kincal model effects`"
    )


def outlier_note(o: Outliers) -> str:
    """Empty unless the outliers cluster or are many."""
    found = []
    if o.clusters:
        where = ", ".join(o.clusters)
        found += [f"the outliers cluster in {where}: this points to an effect, not to bad poses"]
    if not o.few:
        many = f"{len(o.ids)} of {o.poses} poses are outliers"
        found += [f"{many}: a model that has to exclude so many does not explain the data"]
    return "; ".join(found)


def outliers_left(d: Diagnosis) -> str:
    """The outliers of the final model, in words."""
    remaining = "remaining " if any(e.in_model for e in d.effects) else ""
    count = len(d.outliers.ids)
    return f"the {remaining}outlier" if count == 1 else f"the {count} {remaining}outliers"


def in_a_row(o: Outliers) -> str:
    """What it means that outliers were measured one after another; empty if they were not."""
    if not o.in_a_row:
        return ""
    happened = ": they were measured one after another, so something happened then"
    if not o.lasting:
        return happened
    return f"{happened} (if it was a step, it lasts, and leaving them out hides it: measure more poses)"


def among(o: Outliers, poses: Measurements) -> int:
    """How many of these poses are outliers."""
    return poses.n - int(poses.are_not(o.ids).sum())


def without_outliers(count: int, position_m: float, rotation_rad: float | None) -> str:
    """An error without so many outliers."""
    rotation = "" if rotation_rad is None else f", {rotation_rad * 1e3:.2f} mrad"
    return f"{excluded(count)}: {position_m * 1e3:.3f} mm{rotation}"


def excluded(count: int) -> str:
    """That an error is without so many outliers."""
    return f"{_counted(count, 'outlier')} excluded"


def reachable_without(r: Reachable, o: Outliers) -> str:
    """What a black box reaches without the outliers; empty where there are none."""
    count = 0 if r.judged is None else among(o, r.judged)
    return f"{without_outliers(count, *r.errors_without(o.ids))}; " if count else ""


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def alike(a: Alike) -> str:
    """What near poses have in common."""
    near = listed([_NEAR.get(name, in_words(name)) for name in a.by])
    if a.by[0] in SENSOR_AXES:
        near = f"direction of {_axis(a.by[0])} in the frame of the tool"
    what = "its motion" if a.at.startswith("joint") else "its part"
    return f"near poses, by {near}, have {what} at {a.at} in common (p = {a.p_value:.2g})"


def left_over(c: Comparison) -> str:
    """What is left on the fitted poses beside what is known of the noise: stated, estimated or unknown; and
    whether it is noise at all."""
    position = c.rms["fit"][0]
    known, left = c.noise_floor.pos_m, f"{position * 1e3:.3f} mm"
    if known is None:
        repeats = "no repeats" if c.noise_floor.source == UNKNOWN else "too few different repeats"
        text = f"{left}; with no stated noise and {repeats}, its size alone is inconclusive"
    else:
        kind = "noise estimated from replicates" if c.noise_floor.source == REPLICATES else "stated noise"
        text = f"{left}, {position / known:.2f} times the {kind}"
        if position < _FAR_BELOW * known:
            text += ": is it stated in another unit?"
    if c.p_structure > STRUCTURE_P or not c.where:
        if c.alike is not None and c.alike.shown:
            return f"{text}; {alike(c.alike)}: structure, not noise"
        return f"{text}; it depends on no recorded variable"
    first = c.where[0]
    share, variable = percent(first.share_of_variance), _in_sentence(first.variable)
    return f"{text}; {share} of it varies with {variable} at {first.at}: structure, not noise"


_APPROACHED = {
    "direction": "differ by the side that joints came from: backlash shows in them",
    "move": "differ by the length of the last move: the arm was not at rest, or creeps",
    "visit": "of every other visit differ, as if joints came from another side: record it as dir1..",
}


def approached(floor: NoiseFloor) -> str:
    """How replicates differ by the way the arm came to them; empty if they do not."""
    found = floor.approached
    if found is None:
        return ""
    without = "; the noise floor is without that part" if floor.source == REPLICATES else ""
    return f"{_APPROACHED[found.by]} (p = {found.p_value:.3g}){without}"


def unseen(c: Comparison) -> str:
    """Whether poses that the file keeps back are predicted as well as the noise allows; empty if it keeps
    none."""
    if c.p_unseen is None:
        return ""
    worse = "as well as" if c.p_unseen > STRUCTURE_P else "worse than"
    return f"predicted {worse} the noise of the fitted poses allows (p = {c.p_unseen:.3g})"


def adequacy(c: Comparison, *, adequate: bool = True) -> str:
    """Whether the model explains the data; a fit that makes held-out poses worse explains nothing. adequate:
    as of `comparison_text`."""
    if not (c.adequate and adequate):
        return "the model does NOT explain these data"
    but = but_for(c.outliers)
    (before, _), *_, (after, _) = c.errors_without(c.outliers.ids).values()
    if after > before:
        return (
            "the model fits the fitted poses, but predicts held-out poses worse than the nominal arm "
            f"({before * 1e3:.3f} to {after * 1e3:.3f} mm): measure more poses, and more varied ones"
        )
    but += if_noisier(c)
    if c.p_lack_of_fit is None:
        but += ", as far as can be tested without knowing their noise"
    return f"the model explains these data{but}"


def if_noisier(c: Comparison) -> str:
    """On which noise it rests that a model explains the data, where that is more than is stated, beyond
    chance: such a model passes, since data sheets are often no better. Empty otherwise."""
    fit = c.fit_all
    if c.noise_floor.source != STATED or fit.scale < _NOISIER or chi2_tail(fit.chi2, fit.dof) > _CHANCE:
        return ""
    return f", if their noise is {fit.scale:.2f} times the stated one"


def but_for(o: Outliers) -> str:
    """The outliers as an exception, which many are not; empty if there are none."""
    many = "" if o.few else ", too many for a model that explains the data"
    return f", apart from {_counted(len(o.ids), 'outlier')}{many}" if o.ids else ""


def notes(c: Comparison) -> list[str]:
    """What else a reader of a comparison should know."""
    still = [f"joint {j} does not move in these data: its errors cannot be estimated" for j in c.still_joints]
    assumed = sight.in_words(c.fit_all.arm, c.data)
    turned = [] if c.turned is None else [turned_frame(c.turned)]
    return [*c.consistency.doubts, *turned, *still, *([assumed] if assumed else [])]


def length_scale(s: LengthScale) -> str:
    """That all lengths are wrong by one factor, and what to measure."""
    return (
        f"all lengths of the arm differ from its table by {100 * s.share:+.2f} % +- {100 * s.std_err:.2f} %: "
        "a wrong size of the tag or scale of the sensor looks the same; measure the tag"
    )


def turned_frame(t: TurnedFrame) -> str:
    """What is wrong with the frames of orientations and positions, and what to do."""
    x, y, z = (f"{1e3 * v:.2f}" for v in t.rotation_rad)
    return (
        f"orientations and positions are not in one frame: the fit leaves all orientations turned by {x}, "
        f"{y}, {z} mrad about x, y, z of the base, which no error of the arm does; give both in one frame or "
        "leave the orientations out"
    )


def reachable_by(r: Reachable, *, structured: bool) -> str:
    """From what the reachable error was predicted, or why it is that of the model."""
    if not r.enough:
        return "too few poses to tell"
    if not r.parts and structured:
        return "Gaussian process regression on all recorded variables at once predicts none of it"
    if not r.parts:
        return "the residual depends on no recorded variable"
    parts = ", ".join(f"{place} vs {in_words(variable)}" for place, variable in r.parts)
    return f"Gaussian process regression on all recorded variables; largest parts: {parts}"


def not_testable(n: Untestable) -> str:
    """Why an effect could not be tested."""
    absorbed = "absorbed by the fitted parameters (DH, base, tool)"
    return f"{n.name}: {'needs ' + ', '.join(n.needs) if n.needs else absorbed}"


def verdict(d: Diagnosis) -> str:
    """The diagnosis in one sentence, and more where all lengths are wrong by one factor, values have a sign
    that nature does not have, or the noise is correlated in time."""
    scale = d.comparison.length_scale
    found = any(e.in_model and e.hypothesis.effect in _SCALES for e in d.effects)  # says the same
    said = [_verdict(d), *([f"A{length_scale(scale)[1:]}."] if scale and not found else [])]
    said += [f"{text}." for text in _waves(d)]
    said += [f"{text}." for e in d.effects if e.in_model and (text := negative(e.parameters, e.name))]
    if d.serial is not None:
        by_time = d.novel is not None and d.novel.found and "t" in d.novel.depends_on
        random_order = in_random_order(d.comparison.data)
        words = following_time if by_time else correlated
        said.append(words(d.serial, random_order=random_order))
    return " ".join(said)


_SCALES = ("sensor_scale", "tag_scale")
_WAVES = ("encoder_eccentricity", "encoder_harmonic2", "joint_ripple", "second_ripple", "third_ripple")


def _waves(d: Diagnosis) -> list[str]:
    """Joints whose error several waves of their own angle describe: one function may be its cause."""
    waves = [e for e in d.effects if e.in_model and e.hypothesis.effect in _WAVES]
    at = Counter(j for e in waves for j in joints_of(e.name))
    several = [j for j, count in sorted(at.items()) if count > 1]
    if not several:
        return []
    joints = f"joint{'s' if len(several) > 1 else ''} {listed([str(j) for j in several])}"
    return [f"Several waves of {joints} may be one smooth function of the joint's angle"]


def correlated(s: Serial, *, random_order: bool) -> str:
    """That the noise is correlated in time, or may be, and what to do; random_order: the poses were measured
    in such an order already."""
    be = "is" if s.separable else "may be"
    but = "but not by nearby poses measured at other times"
    if not s.separable:
        but = "and no nearby poses were measured at other times to compare them with"
    order = "" if random_order else " and in random order"
    return (
        f"The noise {be} correlated in time: {percent(s.share)} of the remaining error is shared by "
        f"consecutive poses {but}. Effects were therefore judged on whole stretches of the session that were "
        f"held out. To improve: take more poses, at rest{order}."
    )


def following_time(s: Serial, *, random_order: bool) -> str:
    """The same where something that moves with time is found."""
    order = "" if random_order else " and in random order"
    return (
        f"What moves and noise that is correlated in time look alike: {percent(s.share)} of the remaining "
        "error is shared by consecutive poses. Effects were therefore judged on whole stretches of the "
        f"session that were held out. If nothing there moves, take more poses, at rest{order}."
    )


def _verdict(d: Diagnosis) -> str:
    taken = [e for e in d.effects if e.in_model]
    shown = [e.name for e in taken if is_shown(e)]
    open_ = [e.name for e in taken if not is_shown(e)]
    with_them = _with(listed(shown) if shown else "", open_, d)
    if d.verdict == "adequate" and (d.adequate_after or not d.outliers.may_be_chance):
        return f"These data show no missing effect{but_for(d.outliers)}{if_noisier(d.comparison)}."
    if d.serial is not None and not taken and d.novel is None:
        return "The remaining error varies with time, and no effect is shown to cause it."
    if d.verdict == "adequate":
        return f"No effect is shown to be missing, yet the model does not explain these data{_beyond(d)}."
    if d.verdict == "undecidable" and d.comparison.turned is not None and not taken:
        return f"O{turned_frame(d.comparison.turned)[1:]}."
    if d.verdict == "undecidable" and d.novel is not None and not taken:
        return (
            f"More than noise of equal size is left, most of it in {_error_at(d.novel.location)}, but no "
            "effect is shown to predict it: the noise is larger there, or these poses do not determine the "
            "effect."
        )
    if d.verdict == "undecidable" and not taken and (names := _unconfirmed(d)):
        return (
            f"The model explains these data{but_for(d.outliers)}: there is evidence for {listed(names)}, but "
            "poses that were not fitted do not confirm it."
        )
    if d.verdict == "undecidable" and (one := _one_of(d)):
        return f"{one}: {with_them}."
    if d.verdict == "undecidable":
        more = with_them or _closest(d)
        return f"{_more_than_noise(d, shown)}, but these data do not determine what it is: {more}."
    if d.verdict == "novel" and d.novel is not None:
        what = "Something is missing that no effect in the library describes"
        found = f"{what}: {unnamed(d.novel)}{_as_function(d.novel)}"
        if taken:
            return f"{found}; {with_them}."
        return found + ("; held-out poses depend on no recorded variable" if d.exhausted else "") + "."
    accepted = [e.name for e in taken if e.accepted and is_shown(e)]
    if not accepted:
        none = "no effect that helps is likely to be the cause" if any(e.helps for e in taken) else (
            "no effect is shown to help"
        )  # fmt: skip
        return f"{_more_than_noise(d, shown)}, but {none}: {with_them}."
    if shown == accepted:
        with_them = _with("it" if len(shown) == 1 else "them", open_, d)
    named = [_with_others(e, d) for e in taken if e.name in accepted]
    return f"Consistent with {listed(named)}: {with_them}."


def _beyond(d: Diagnosis) -> str:
    """How far what is left is beyond a known noise; empty where that is little or unknown."""
    known, left = d.comparison.noise_floor, d.comparison.rms["fit"][0]
    if known.pos_m is None or left < _FAR_BEYOND * known.pos_m:
        return ""
    kind = "noise estimated from replicates" if known.source == REPLICATES else "stated noise"
    return f": what is left is {left / known.pos_m:.1f} times the {kind}"


def _more_than_noise(d: Diagnosis, shown: Sequence[str]) -> str:
    """That something is missing, where that is sure: evidence alone takes noise that is larger at some poses
    (of joints far from the tool, say) for something missing. shown: effects that are shown to help."""
    c = d.comparison
    sure = c.p_lack_of_fit is not None or c.structured or c.outliers.clusters or c.kept_back is not None
    return "Something is missing" if shown or sure else "More than noise of equal size is left"


def _one_of(d: Diagnosis) -> str:
    """That one of several effects is there, and that these data leave open which; empty where that is not
    so."""
    for e in d.effects:
        names = [e.name, *_likely_confounded(e, d)]
        if e.accepted and e.doubts.either > _CLAIMED and len(names) > 1:
            said = f"{', '.join(names[:-1])} or {names[-1]}"
            return (
                f"Consistent with {said}, which these data cannot tell apart "
                f"({probability(e.doubts.either)} that it is one of them)"
            )
    return ""


def _unconfirmed(d: Diagnosis) -> list[str]:
    """Effects that were taken back where the model explains the data without them."""
    return [e.name for e in d.effects if e.taken_back] if d.adequate_after else []


def _with_others(e: EffectFinding, d: Diagnosis) -> str:
    """An effect by name, with those that it may be as well."""
    others = _likely_confounded(e, d) if is_confounded(e) else []
    return f"{e.name} (or {' or '.join(others)})" if others else e.name


def _likely_confounded(e: EffectFinding, d: Diagnosis) -> list[str]:
    """Likely effects that these data cannot tell from this one."""
    return [x.name for x in d.effects if x.name in e.confounded_with and not x.in_model]


def is_shown(e: EffectFinding) -> bool:
    """An effect of the final model that may be named as found: held-out poses or, where none are held out,
    evidence decide for it, and it is more likely than not."""
    measured = math.isfinite(e.held.after_m)
    likely = e.role == "helps" or e.probability >= LIKELY
    return e.in_model and likely and (e.helps or not measured)


def _with(shown: str, undecided: Sequence[str], d: Diagnosis) -> str:
    """What the effects of the final model bring together: those that are shown to help, in words, and those
    that may or may not."""
    if not undecided:
        return f"with {shown}, {_held_fall(d)}" if shown else ""
    open_ = f"{listed(undecided)} (undecided)"
    return f"with {f'{shown}, and with {open_}' if shown else open_}, {_held_fall(d)}"


def _as_function(u: UnnamedFinding) -> str:
    """What held-out poses say of a smooth function there, unless they gain."""
    if not u.curves or not math.isfinite(u.held.after_m) or u.held.gains:
        return ""
    return f" (modelled as a smooth function: {u.held.judged})"


def _held_fall(d: Diagnosis) -> str:
    before, after = d.comparison.rms["held"][0], d.remainder.held_pos_m
    if not (math.isfinite(before) and math.isfinite(after)):
        return "the poses fit better (none are held out, so the gain is not measured)"
    last, given = d.advised.headline[-1], given_errors(d)
    verb = "falls" if last.pos_m < given[0] else "changes"
    text = f"the {held_error(d)} {verb} from {fall(given[0], last.pos_m)}"
    if count := among(d.outliers, judged(d)):
        text += f" ({excluded(count)}: {fall(given[1], last.usual[0])})"
    return text


def held_error(d: Diagnosis) -> str:
    """Which error is said first: few held-out poses say little."""
    return "cross-validated error" if d.advised.crossed else "held-out error"


def judged(d: Diagnosis) -> Measurements:
    """The poses of that error."""
    return d.comparison.fit_all.data if d.advised.crossed else d.comparison.measured


def given_errors(d: Diagnosis) -> tuple[float, float]:
    """That error of the given model [m], with all poses and without the outliers of the final model."""
    if (crossed := d.advised.crossed_given) is not None:
        return crossed.pos_m, crossed.usual[0]
    without = [*d.comparison.errors_without(d.outliers.ids).values()][-1][0]
    return d.comparison.rms["held"][0], without


def fall(before_m: float, after_m: float) -> str:
    """From one error to another."""
    return f"{before_m * 1e3:.3f} to {after_m * 1e3:.3f} mm"


FOLLOWS_ORIENTATION = (
    "the error follows the orientation of the tool as the sensor sees it: look at the target and its "
    "calibration, at the sensor's line of sight, and at a tool that bends"
)
"""Of a function of the tool's orientation: what may be its cause."""
SENSOR_LAGS = (
    "the measured pose stays behind along the way from the pose before, or runs ahead: behind, look for a "
    "filter or an average over time in the sensor, or poses older than the readings; ahead, for readings "
    "older than the poses, or overshoot; measure again after waiting longer"
)
"""Of a function of the tool's last move: what may be its cause."""


def cause_without_terms(name: str) -> str:
    """What may be the cause of something unnamed that no term can follow; empty for anything else."""
    parsed = UnnamedName.parse(name)
    if parsed.of_tool_move:
        return SENSOR_LAGS
    return FOLLOWS_ORIENTATION if parsed.without_terms else ""


NO_TERM = "no term of a model can follow it, and functions of the joints would only stand for it"
"""Of such a function: why it is not added."""

MAY_BE_NOISE = (
    "poses that were not fitted do not confirm it: larger noise at this location (of an encoder, say) looks "
    "the same"
)
"""Of something unnamed that has evidence, but predicts nothing."""


def _closest(d: Diagnosis) -> str:
    if d.comparison.outliers.clusters:
        return outlier_note(d.comparison.outliers)
    if d.comparison.alike is not None and d.comparison.alike.shown:
        return f"{alike(d.comparison.alike)}, as no variable of the map describes"
    names = [e.name for e in d.effects][:3]
    return f"{listed(names)} come closest" if names else "no effect stands out"


def unnamed(u: UnnamedFinding) -> str:
    """What is known of an unnamed effect: the error of joint 1 depends on q1 and q3."""
    where = _error_at(u.location)
    if tuple(u.depends_on) == ("order",):
        return f"{where} drifts over the session"
    verb = "drifts with" if _SLOW.issuperset(u.depends_on) else "depends on"
    return f"{where} {verb} {listed([_in_sentence(name) for name in u.depends_on])}"


def grouped(names: tuple[str, ...]) -> str:
    """Effect names, places of one effect together: gain[1], flex, gain[2], gain -> gain, [1], [2]; flex."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(effect_of(name), []).append(place_of(name))
    return "; ".join(effect + ", ".join(sorted(places, key=bool)) for effect, places in groups.items())
