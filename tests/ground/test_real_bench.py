"""The bench over a folder of real sets (`make real`), on a small folder of simulated ones."""

import json
import subprocess
import sys

import halves
import numpy as np
import poses
import pytest
import real
from places import DATA

NAMES = ["fr3", "ur10d", "ur5", "wam"]


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """(finished process, rows): a good set with a judging file, a set with a malformed row, one whose arm
    table is no TOML, and a folder without an arm table."""
    folder = tmp_path_factory.mktemp("sets")
    for name in ("good", "torn", "noarm", "lonely"):
        (folder / name).mkdir()
        path = poses.poses_csv(folder / name / f"{name}.csv", 50, 3, position_only=True)
        if name != "lonely":
            poses.arm_toml(folder / name / f"{name}.toml", masses=False)
        if name == "torn":
            lines = path.read_text().splitlines()
            path.write_text("\n".join([*lines[:5], "torn,1,2"]) + "\n")
    (folder / "good" / "map.toml").write_text('[columns]\nq = "q{}"\n')
    (folder / "noarm" / "noarm.toml").write_text("not = [toml")
    whole = (folder / "good" / "good.csv").read_text().splitlines()
    (folder / "good" / "good_random.csv").write_text("\n".join([whole[0], *whole[1:13]]) + "\n")
    out = folder / "rows.json"
    command = [sys.executable, real.__file__, str(folder), "--json", str(out)]
    process = subprocess.run(command, capture_output=True, text=True, timeout=300)
    return process, {row["name"]: row for row in json.loads(out.read_text())}


def test_every_set_gives_a_row_and_a_failing_one_its_error(done):
    process, rows = done
    assert process.returncode == 1, process.stderr
    assert list(rows) == ["good", "good_random", "noarm", "torn"]
    assert "Traceback" not in process.stdout + process.stderr
    assert "torn.csv" in rows["torn"]["error"]
    assert "noarm.toml" in rows["noarm"]["error"]
    assert not rows["good"]["error"]


def test_a_row_has_the_figures_of_the_data(done):
    """50 poses with 0.5 mm of noise a component: DH errors are found, the stated noise is the floor."""
    _, rows = done
    good = rows["good"]
    assert good["poses"] == 50
    stated = 1e3 * float(np.linalg.norm(poses.SIGMA[:3]))
    assert good["noise"][0] == pytest.approx(stated, rel=1e-6)
    assert good["nominal"][0] > good["dh"][0] > 0.7 * stated
    assert good["dh"][1] is None


def test_a_random_file_is_predicted_with_the_models_of_its_set(done):
    process, rows = done
    judged = rows["good_random"]
    assert judged["judged"]
    assert judged["poses"] == 12
    # poses of the set itself: the fitted model leaves less than the nominal arm
    assert judged["dh"][0] < judged["nominal"][0]
    assert 0.0 < judged["offset_mm"] < judged["named"][0]
    assert [line for line in process.stdout.splitlines() if line.startswith("  good_random")]


def test_a_folder_without_sets_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["real.py", str(tmp_path)])
    assert real.main() == 2
    assert "no set" in capsys.readouterr().err


def test_without_a_folder_the_sets_that_ship_are_taken():
    """In every clone: nothing beside it is looked for."""
    for bench in (real, halves):
        assert [case.name.split("/")[-1] for case in bench.find_sets(bench.DATA)] == NAMES


@pytest.mark.parametrize("folder", sorted(p for p in DATA.iterdir() if p.is_dir()), ids=lambda p: p.name)
def test_a_set_that_ships_has_its_notice_and_its_source(folder):
    notice = (folder / "LICENSE").read_text()
    assert notice.startswith("MIT License\n\nCopyright (c) 20")
    assert "Permission is hereby granted, free of charge" in notice
    said = (folder / "README.md").read_text()
    assert "https://github.com/" in said
    assert "[LICENSE](LICENSE)" in said
    assert f"[{folder.name}]({folder.name}/README.md)" in (DATA / "README.md").read_text()
