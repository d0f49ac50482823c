"""Mutants of Python: what is changed, what is left alone, and what counts as killed."""

import importlib
import sys
from pathlib import Path

import pytest
from mutants import Count, Mutant
from mutants_python import Source
from mutation_ground import MOST_EXCUSED, ROOMS, Instead, digest, drawn, modules, patch, paths_of_tests

TEXT = '''"""Ä docstring: 1 < 2."""
from __future__ import annotations
LIMIT = 4

@cache(1)
def cut(x: int | None, least: int = 0, name: str = "") -> int | None:
    """Also 1."""
    if x is None or not (x + 1 < LIMIT):
        raise ValueError(f"{x + 1}" + "1")
    rows[x] = min(-x,  # not 1 < 2
                  2.5)
    x += 1
    return x if least else None
'''
CHANGES = {
    ("LIMIT = 4", "LIMIT = (4 - 1)"),
    ("least: int = 0", "least: int = 1"),
    ('name: str = ""', 'name: str = "mutant"'),
    ("if x is None or", "if not (x is None or"),
    ("x is None", "x is not None"),
    ("None or not", "None and not"),
    ("or not (", "or ("),
    ("x + 1 < LIMIT", "x - 1 < LIMIT"),
    ("x + 1 < LIMIT", "x + (1 - 1) < LIMIT"),
    ("1 < LIMIT", "1 <= LIMIT"),
    ("1 < LIMIT", "1 >= LIMIT"),
    ('raise ValueError(f"{x + 1}" + "1")', "pass"),
    ("rows[x] = min(-x,  # not 1 < 2\n                  2.5)", "pass"),
    ("min(-x", "max(-x"),
    ("min(-x", "min(x"),
    ("2.5", "(2.5 * 1.5)"),
    ("x += 1", "pass"),
    ("x += 1", "x -= 1"),
    ("x += 1", "x += (1 - 1)"),
    ("x if least", "x if not (least)"),
}


def test_operators_conditions_constants_defaults_and_statements_are_changed_and_nothing_else():
    source = Source("ground/kincal/x.py", TEXT)
    found = {m.of(TEXT) for m, _ in source.changes() if source.differs(m)}
    wanted = set()
    for old, new in CHANGES:
        assert TEXT.count(old) == 1 or old in ("1 < LIMIT", "x + 1 < LIMIT"), old
        after = TEXT.replace(old, new)
        # a negation has its closing bracket at the end of the condition
        wanted.add(after.replace("LIMIT):", "LIMIT)):") if new.startswith("if not (x") else after)
    assert found == wanted


def test_a_mutant_knows_its_function_and_the_lines_of_its_statement():
    places = {m.text: p for m, p in Source("ground/kincal/x.py", TEXT).changes()}
    assert (places["max"].function, places["max"].lines) == ("cut", (10, 11))
    assert places['"mutant"'].lines == tuple(range(7, 14))  # a default: any line of the function
    assert (places["(4 - 1)"].function, places["(4 - 1)"].lines) == ("", ())


def test_what_only_differs_in_its_text_is_no_mutant():
    source = Source("ground/kincal/x.py", TEXT)
    assert not source.differs(Mutant(source.path, TEXT.index("2.5"), TEXT.index("2.5") + 3, "(2.5)"))
    assert not source.differs(Mutant(source.path, 0, 0, "("))


def test_a_seed_draws_the_same_mutants_again_and_another_one_others():
    first, again, other = (drawn("keys", 20, seed, "", 0) for seed in (1, 1, 2))
    assert [m for m, *_ in first] == [m for m, *_ in again] != [m for m, *_ in other]
    assert len({(m.path, m.start, m.end, m.text) for m, *_ in first}) == 20


@pytest.mark.parametrize("room", ROOMS)
def test_every_room_has_modules_for_a_hundred_mutants(room):
    assert all(path.is_file() for path in paths_of_tests())
    assert len(drawn(room, 100, 1, "", 0)) == 100, modules(room)


def test_a_mutant_is_loaded_in_place_of_its_module(monkeypatch):
    path = "ground/kincal/rotations.py"
    text = (Path(__file__).parents[2] / path).read_text()
    before = importlib.import_module("kincal.rotations")
    finder = Instead(Mutant(path, len(text), len(text), "\nMUTANT = 1\n"), text)
    monkeypatch.setattr(sys, "meta_path", [finder, *sys.meta_path])
    monkeypatch.delitem(sys.modules, "kincal.rotations")
    after = importlib.import_module("kincal.rotations")
    monkeypatch.setitem(sys.modules, "kincal.rotations", before)
    assert after.MUTANT == 1
    assert after.__file__ == before.__file__


def test_survivors_with_and_without_a_reason_are_counted(monkeypatch, capsys):
    row = {"file": "a.py", "function": "f", "original": "x < 1", "mutant": "x <= 1", "verdict": "equivalent"}
    monkeypatch.setattr("mutants.reviewed", lambda: {("a.py", "f", "x < 1", "x <= 1"): row})
    count, text = Count(), "x < 1\n"
    for mutant, killed in ((Mutant("a.py", 2, 3, "<="), False), (Mutant("a.py", 2, 3, ">="), False)):
        count.add(mutant, "f", text, killed)
    count.add(Mutant("a.py", 4, 5, "2"), "f", text, True)
    assert (count.killed, count.excused, count.new, count.total) == (1, 1, 1, 3)
    assert count.share == 0.5
    assert capsys.readouterr().out.count("NOT KILLED: a.py:1, f") == 1
    assert MOST_EXCUSED <= 0.05


def test_what_was_found_is_forgotten_when_a_test_file_changes(tmp_path, monkeypatch):
    monkeypatch.setattr("mutation_ground.ROOT", tmp_path)
    file = tmp_path / "test_x.py"
    file.write_text("1")
    before = digest([file])
    file.write_text("2")
    assert digest([file]) != before


@pytest.mark.parametrize("loaded", [True, False])
def test_the_functions_of_a_module_take_the_code_of_a_mutant_loaded_before_or_not(loaded, monkeypatch):
    path = "ground/kincal_shared/keys.py"
    text = (Path(__file__).parents[2] / path).read_text()
    at = text.index("+ 1", text.index("def counting()"))
    keys = importlib.import_module("kincal_shared.keys")
    monkeypatch.setattr(sys.modules["kincal_shared"], "keys", keys)
    monkeypatch.setitem(sys.modules, "kincal_shared.keys", keys)
    if not loaded:
        del sys.modules["kincal_shared.keys"]
    old = keys.counting.__code__
    try:
        patch(Mutant(path, at, at + 3, "+ 5"), text)
        assert sys.modules["kincal_shared.keys"].counting()(1) == 5
    finally:
        keys.counting.__code__ = old
    assert keys.counting()(1) == 1
