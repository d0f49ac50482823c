"""`pip install ./ground` in a fresh environment: the wheel works anywhere, what is missing is named.

The environments hold the wheel, the packages it declares, and nothing else. The packages are linked from
the environment of the tests, so that no network is needed."""

import ctypes
import json
import struct
import zipfile

import click
import numpy as np
import poses
import pytest
from commands import FIGURES
from environments import asked, loaded, run
from places import ROOT

from kincal.cli import main

pytestmark = pytest.mark.slow

GIVEN = ("--arm", "arm.toml", "--data", "poses.csv")
URDF = """<robot name="two"><link name="base"/><link name="one"/><link name="two"/>
<joint name="a" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 0 1"/>
<origin xyz="0 0 0.3"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="b" type="revolute"><parent link="one"/><child link="two"/><axis xyz="0 1 0"/>
<origin xyz="0.4 0 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint></robot>
"""


@pytest.fixture(scope="module")
def user(door, tmp_path_factory):
    """A user's folder: measurements, an arm, a model, a run of the wheel's own simulator and a campaign."""
    folder = tmp_path_factory.mktemp("user")
    poses.arm_toml(folder / "arm.toml")
    poses.poses_csv(folder / "poses.csv", 45, 12, lambda q, d: q + np.array([0, 0, 0, 3e-3 * d[3], 0, 0, 0]))
    (folder / "robot.urdf").write_text(URDF)
    (folder / "small.toml").write_text('scenario = "healthy"\ncases = 1\nset = { "calibration.poses" = 1 }\n')
    calls = (
        ("model", "add", "--model", "M.toml", "backlash[4]"),
        ("model", "fit", *GIVEN, "--model", "M.toml"),
        ("run", "healthy", "--fast", "--no-compare", "--no-summary", "--out", "run"),
        ("campaign", "run", "small.toml", "--out", "campaign"),
    )
    *_, flown, campaign = done = asked(door, folder, tmp_path_factory.mktemp("user-answers"), calls)
    assert [one.returncode for one in done] == [0] * 4, [one.stderr for one in done]
    assert "passed in" in flown.stdout and "1 of 1 cases" in campaign.stdout
    return folder


# --------------------------------------------------------------------------- what is in it


def test_wheel_holds_what_it_runs(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    messages = {f"kcm/{p.stem}.py" for p in (ROOT / "fsw" / "msg").glob("*.lcm")}
    tree = {f"kincal/_tree/{name}" for name in ("sim/scenarios/paper.toml", "sim/campaigns/errors.toml",
            "sim/models/detector.yml", "tables/bin/space.tbl", "tables/src/space.toml", "build/kincal-fsw",
            "build/kincal-tagdet", "build/libsim_native.so")}  # fmt: skip
    assert {"kincal/_core/libkincal.so", "kincal/_core/kincal_cdef.h", "kincal/_core/musl.COPYRIGHT",
            "kincal/_core/monocypher.LICENCE.md",
            "kincal/workbench/model/effects.toml",
            "kincal/_core/libkincal_ground.so", "kincal_shared/schema/channels.csv",
            "kincal_shared/schema/messages.csv", "kincal_shared/schema/variables.csv",
            "kincal_shared/arms/wam.toml",
            "kincal/pages/GLOSSARY.md", "kincal_shared/errors.py", "kincal_sim/launch.py",
            "kincal/pages/templates/page.html.j2", "kincal/console/static/main.js",
            "kincal/console/static/console.css",
            "kincal/_tree/fsw/tables/kc_events.toml"} | messages | tree <= names  # fmt: skip
    assert not [n for n in names if "__pycache__" in n]


def test_core_in_the_wheel_gives_the_bits_of_the_core_that_flies(wheel, tmp_path):
    zipfile.ZipFile(wheel).extract("kincal/_core/libkincal.so", tmp_path)
    answers = []
    for path in (tmp_path / "kincal/_core/libkincal.so", ROOT / "build" / "libkincal.so"):
        lib = ctypes.CDLL(str(path))
        out = (ctypes.c_double * 4)()
        rotation = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]).ravel()
        lib.kc_R_to_quat((ctypes.c_double * 9)(*rotation), out)
        answers.append(bytes(out))
    assert answers[0] == answers[1]


def test_environments_are_clean(plain, full, tmp_path):
    ask = (
        "import importlib.util as u, sys; print([u.find_spec(n) is not None for n in sys.argv[1:]], sys.path)"
    )
    for home, there in ((plain, False), (full, True)):
        found, _, path = run(
            home / "bin" / "python", "-c", ask, "kincal", "pytest", "mujoco", "kaleido", cwd=tmp_path
        ).partition("]")
        assert found == f"[True, False, {there}, {there}"
        assert str(ROOT) not in path


# --------------------------------------------------------------------------- every command

NOBODY = ("--url", "udpm://239.255.76.67:1?ttl=0", "--timeout", "0.2")
RUN_LOG = "run/run.lcmlog"
# command -> arguments; runs in the user's folder
CALLS = {
    "table build": ("{tables}/src/config.toml", "new/config.tbl"), "table show": ("{tables}/bin/arm.tbl",),
    "table check": ("{tables}/bin/arm.tbl",),
    "table diff": ("{tables}/src/config.toml", "{tables}/bin/config.tbl"),
    "table uplink": ("{tables}/bin/config.tbl", *NOBODY), "table dump": ("kin", "new/kin.tbl", *NOBODY),
    "space build": ("{tables}/src/space.toml", "new/space.tbl"),
    "space show": ("{tables}/bin/space.tbl",), "space explain": ("{tables}/bin/space.tbl", "17"),
    "space check": ("{tables}/bin/space.tbl",),
    "space diff": ("{tables}/bin/space.tbl", "{tables}/bin/space.tbl"),
    "space information": ("{tables}/bin/space.tbl",), "space separability": ("{tables}/bin/space.tbl",),
    "run": ("healthy", "--fast", "--no-compare", "--out", "new/run"),
    "campaign run": ("small.toml", "--out", "campaign"), "campaign report": ("campaign",),
    "campaign replay": ("campaign", "0"), "log": (RUN_LOG,), "review list": (RUN_LOG,),
    "review show": (RUN_LOG, "--picture", "new/review.png"), "audit verify": (RUN_LOG,),
    "review arm": ("12345678", "--by", "me", "--why", "because", *NOBODY),
    "review go": ("12345678", "--by", "me", "--why", "because", *NOBODY),
    "review reject": ("12345678", "--by", "me", "--why", "because", *NOBODY),
    "review comment": ("looks good", "--by", "me"), "review history": (RUN_LOG,),
    "review watch": ("--live", "--seconds", "0.2", *NOBODY[:2]), "audit log": (), "command noop": NOBODY,
    "command start": NOBODY, "command abort": NOBODY, "command rollback": NOBODY,
    "command validate": ("config", "12345678", *NOBODY), "command activate": ("config", "12345678", *NOBODY),
    "command discard": NOBODY, "command arm": ("12345678", "--by", "me", "--why", "because", *NOBODY),
    "command go": ("12345678", "--by", "me", "--why", "because", *NOBODY),
    "command reject": ("12345678", "--by", "me", "--why", "because", *NOBODY),
    "command dump": ("kin", "new/kin.tbl", *NOBODY), "status": ("--seconds", "0.2", *NOBODY[:2]),
    "record": ("--folder", "new/recordings", "--seconds", "0.5", *NOBODY[:2]), "key new": ("new/keys",),
    "key rotate": ("new/keys",), "key show": ("new/keys",), "key join": ("new/keys", "-o", "new/flight.keys"),
    "key retire": ("new/keys",), "export xtce": ("-o", "new/kincal.xml"),
    "bridge ccsds": ("--to", "127.0.0.1:9", "--seconds", "0.2", *NOBODY[:2]), "schema": ("-o", "new/schema"),
    "serve": ("--port", "0", "--seconds", "0.5", "--log", RUN_LOG), "arm list": (), "arm show": ("ur5e",),
    "arm import": ("robot.urdf", "-o", "new/arm.toml"), "model check": GIVEN, "model compare": GIVEN,
    "model diagnose": (*GIVEN, "--report", "new/report.html"), "model fit": (*GIVEN, "--model", "M.toml"),
    "model predict": ("--model", "M.toml", "--data", "poses.csv"), "model effects": (),
    "model add": ("--model", "new/M.toml", "base_flex"),
    "model remove": ("--model", "new/M.toml", "base_flex"), "model undo": ("--model", "new/M.toml"),
    "model list": ("--model", "M.toml"), "model history": ("--model", "M.toml"),
    "model next": (*GIVEN, "joint_compliance[2]", "base_flex"),
    "model export": ("--model", "M.toml", "--format", "c", "-o", "new/calibrated.c"),
    "model uplink": ("--model", "M.toml", "--arm", "arm.toml", "--fly", "new/fly"),
}  # fmt: skip
SLOW = ("space build", "space check")  # not run to their end
# command or group -> extra
NEEDS = {
    "run": "sim", "space": "sim", "arm import": "urdf", "serve": "console", "export xtce": "xtce",
    "campaign": "campaign",
}  # fmt: skip
NO_ANSWER = ("uplink", "dump", "approve", "reject")  # nobody is there to talk to


def commands(group=main, prefix=""):
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, f"{prefix}{name} ")
        else:
            yield f"{prefix}{name}"


def called(door, home, user, answers, names):
    """name -> status, output and messages of each command, run one after the other in the user's folder."""
    tables = next(home.glob("lib/*/site-packages/kincal/_tree/tables"))
    (user / "new").mkdir(exist_ok=True)
    calls = [[*name.split(), *(word.format(tables=tables) for word in CALLS[name])] for name in names]
    return dict(zip(names, asked(door, user, answers, calls), strict=True))


def test_every_command_is_tried():
    assert set(CALLS) == set(commands())


@pytest.fixture(scope="module")
def clean(plain, user, tmp_path_factory):
    """Every command in an environment without any extra."""
    with loaded(plain) as door:
        return called(door, plain, user, tmp_path_factory.mktemp("plain-answers"), list(CALLS))


@pytest.mark.parametrize("name", CALLS)
def test_command_runs_or_names_the_extra_in_a_clean_environment(name, clean):
    done = clean[name]
    assert "Traceback" not in done.stdout + done.stderr, done.stderr
    extra = NEEDS.get(name) or NEEDS.get(name.split()[0])
    if extra and done.returncode == 2:
        assert f"pip install 'kincal[{extra}]'" in done.stderr
    elif name == "table uplink" or name.split()[-1] in NO_ANSWER and name != "model uplink":
        assert done.returncode == 1, done.stderr
    else:
        assert done.returncode in (0, 1), done.stderr


# What an extra is for; the report of a diagnosis has pictures. Runs and campaigns were flown with it for the
# user's folder, and passed.
WITH_EXTRA = [n for n in CALLS if NEEDS.get(n) or NEEDS.get(n.split()[0]) or n == "model diagnose"]
WITH_EXTRA = [n for n in WITH_EXTRA if n not in (*SLOW, "run", "campaign run")]


@pytest.fixture(scope="module")
def equipped(door, full, user, tmp_path_factory):
    return called(door, full, user, tmp_path_factory.mktemp("full-answers"), WITH_EXTRA)


@pytest.mark.parametrize("name", WITH_EXTRA)
def test_command_that_an_extra_is_for_runs_with_it(name, equipped):
    done = equipped[name]
    assert "Traceback" not in done.stdout + done.stderr, done.stderr
    assert "pip install" not in done.stderr
    assert done.returncode in (0, 1), done.stderr


@pytest.mark.usefixtures("equipped")
def test_report_of_a_diagnosis_has_a_picture_of_every_figure(user):
    made = {path.stem.removeprefix("report-"): path.read_bytes() for path in user.glob("new/report-*.png")}
    assert set(made) == set(FIGURES)
    for png in made.values():
        assert png.startswith(b"\x89PNG") and min(struct.unpack(">II", png[16:24])) > 100


def test_page_is_written_without_the_image_extra_and_says_why_there_is_no_picture(clean, user):
    done = clean["review show"]
    assert "no pictures" in done.stderr
    assert "pip install 'kincal[image]'" in done.stderr
    assert (user / "new" / "review.html").stat().st_size > 1_000_000


# --------------------------------------------------------------------------- a user's day


def test_workbench_runs_from_another_folder_on_a_users_own_arm(plain, user, clean, tmp_path):
    """With nothing loaded begins the diagnosis here, and the commands of README and tutorial."""
    where = run(plain / "bin" / "python", "-c", "import kincal; print(kincal.__file__)", cwd=tmp_path)
    assert str(plain) in where
    given = ("--arm", user / "arm.toml", "--data", user / "poses.csv")
    got = json.loads(run(plain / "bin" / "kincal", "model", "diagnose", *given, "--json", cwd=tmp_path))
    assert (got["verdict"], got["effects"][0]["name"]) == ("effect", "backlash[4]")
    for name, words in (("model fit", "noise floor"), ("model uplink", "terms"), ("model compare", "WAM")):
        assert clean[name].returncode == 0, clean[name].stderr
        assert words in clean[name].stdout
