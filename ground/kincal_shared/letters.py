"""Characters that nobody sees in a name: two names that look alike must not be two."""

from __future__ import annotations

# Shown as nothing or as a blank, though Unicode counts them as letters, marks or symbols: Hangul fillers, the
# Braille blank, a notehead of no shape, joiners, and selectors of variants (Default_Ignorable_Code_Point of
# Unicode 15).
_BLANK = {0x034F, 0x115F, 0x1160, 0x17B4, 0x17B5, 0x2800, 0x3164, 0xFFA0, 0x1D159}
_SELECTORS = ((0x180B, 0x180F), (0xFE00, 0xFE0F), (0xE0000, 0xE0FFF))


def unseen(text: str) -> str:
    """The first character that is not shown, as U+3164; empty if all are. A plain blank is shown; so are
    bytes of a file name that are no text, which are reported where it is opened."""
    return next((f"U+{ord(char):04X}" for char in text if _is_unseen(char)), "")


def shown(text: str) -> str:
    """The text with the code of every character that is not shown in its place: q1\\u200b."""
    return "".join(char.encode("unicode_escape").decode() if _is_unseen(char) else char for char in text)


def without_unseen(text: str) -> str:
    """The text as people read it."""
    return "".join(char for char in text if not _is_unseen(char))


def _is_unseen(char: str) -> bool:
    code = ord(char)
    if 0xDC80 <= code <= 0xDCFF:
        return False
    selects = any(first <= code <= last for first, last in _SELECTORS)
    return code in _BLANK or selects or not char.isprintable()
