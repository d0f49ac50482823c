"""The model that a diagnosis advises: effects as `kincal model add` takes them, and the errors that the
advised commands will print."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from kincal_shared.schema.arm import ArmTable
from kincal_shared.schema.names import effect_of, is_unnamed, split_constants, with_constants

from ..data.measurements import Measurements
from ..evidence.constants import Choice
from ..model.effects import Hypothesis, Library
from ..model.hypotheses import joints_of
from ..prediction.nested import CROSSED, NestedModel, errors_by_step


@dataclass(frozen=True)
class Advised:
    """What to change about a model, and what that brings.

    removed: effects that an added one holds at more joints; added: effects with the constants that were found
    (joint_ripple[2](k=4)), best first; errors: of the nominal arm, after DH calibration and with each
    effect of the model that results, as `kincal model fit` measures them on the same poses; crossed: the same
    of poses held out in turns, where those held out at once are few; empty where they are not; crossed_given:
    of the model that was given, None where `crossed` is empty.
    """

    removed: tuple[str, ...]
    added: tuple[str, ...]
    errors: tuple[NestedModel, ...]
    crossed: tuple[NestedModel, ...] = ()
    crossed_given: NestedModel | None = None

    @property
    def headline(self) -> tuple[NestedModel, ...]:
        """The errors to go by."""
        return self.crossed or self.errors

    def model_after(self, given: Sequence[str]) -> tuple[str, ...]:
        """The effects of a model once it is done."""
        return (*(text for text in given if text not in self.removed), *self.added)


NOTHING_ADVISED = Advised((), (), ())


def texts_of(hypotheses: Iterable[Hypothesis]) -> tuple[str, ...]:
    """Effects by name with their constants."""
    return tuple(with_constants(h.name, dict(h.constants)) for h in hypotheses)


def advised(
    arm: ArmTable,
    data: Measurements,
    library: Library,
    given: Sequence[str],
    found: Sequence[Hypothesis],
    *,
    dh: bool,
    outliers: Collection[str] = (),
) -> Advised:
    """The model of these effects and those that were found beside them. given: as `add` takes them; outliers:
    ids of poses without which the errors are given too.

    The errors are computed as `kincal model fit` does it, from what `add` writes: no other way gives the same
    digits.
    """
    change = Advised(*joined(library, given, texts_of(found)), ())

    def errors(texts: Sequence[str]) -> tuple[NestedModel, ...]:
        choice = Choice(library, tuple(texts), arm, data, dh)
        names = [split_constants(text)[0] for text in texts]
        return errors_by_step(
            arm, data, choice.hypotheses, names, dh=dh, outliers=outliers, anew=choice.anew
        )  # fmt: skip

    every = errors(change.model_after(given))
    crossed = tuple(e for e in every if e.block == CROSSED)
    first = crossed[: 2 if dh else 1]
    if crossed and given:
        first = tuple(e for e in errors(given) if e.block == CROSSED)
    return replace(
        change,
        errors=tuple(e for e in every if e.block != CROSSED),
        crossed=crossed,
        crossed_given=first[-1] if first else None,
    )


def joined(
    library: Library, given: Sequence[str], found: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What to take out of a model and what to add, so that no effect stands in it twice at one joint: one
    that was found takes the place of what it holds, with all joints of both."""
    removed: list[str] = []
    added: dict[str, str] = {}
    for text in found:
        name, constants = split_constants(text)
        for other in (*given, *added.values()):
            its_name, _ = split_constants(other)
            if other in removed or not _overlap(library, name, its_name):
                continue
            name = _of_both(name, its_name)
            if other in given:
                removed.append(other)
            else:
                del added[its_name]
                break
        added[name] = with_constants(name, constants)
    return tuple(removed), tuple(added.values())


def _overlap(library: Library, a: str, b: str) -> bool:
    """One effect at one joint by two names; a pair of joints is a place of its own."""
    effect = library.effect(a)
    if effect_of(a) != effect_of(b) or is_unnamed(a) or effect is None:
        return False
    mine, its = joints_of(a), joints_of(b)
    return a == b or not mine or not its or (effect.per == "joint" and bool(set(mine) & set(its)))


def _of_both(a: str, b: str) -> str:
    mine, its = joints_of(a), joints_of(b)
    if not mine or not its:
        return effect_of(a)
    return f"{effect_of(a)}[{','.join(map(str, sorted({*mine, *its})))}]"
