"""Sealed hidden effects against the workbench, six of them; `make blind` runs the whole battery."""

import sys

import blind


def test_six_sealed_cases_meet_the_criteria(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["blind.py", "--quick", "--dir", str(tmp_path)])
    assert blind.main() == 0, capsys.readouterr().out
