"""Files that people write: every key of every kind, mistyped, left out or of the wrong type, is named."""

import copy
import json
import tomllib
from functools import cache

import pytest
from commands import shell, text_of
from places import DATA, ROOT

from kincal.flight import library
from kincal.workbench.model.effects import Library
from kincal_shared.errors import BadInput
from kincal_shared.schema import arm, base, errors, files, scenario, space, tables
from kincal_shared.schema.errors import SchemaError, read_toml, validate
from kincal_shared.schema.names import ACQUISITIONS

SHIPPED = {
    "arm": ROOT / "ground/kincal_shared/arms/wam.toml",
    "effects": ROOT / "ground/kincal/workbench/model/effects.toml",
    "space": ROOT / "tables/src/space.toml",
    "campaign": ROOT / "sim/campaigns/errors.toml",
    "simulator-arm": ROOT / "sim/models/wam.toml",
    "simulator-camera": ROOT / "sim/models/camera.toml",
    **{f"table-{kind}": ROOT / f"tables/src/{kind}.toml" for kind in tables.SOURCES},
}
FRAME = {"xyz_m": [0.0, 0.0, 0.0], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]}
EXPECTED = {"held_out": "held-out poses", "poses": 20, "distinct": 19, "mm": 0.2, "usual_mm": 0.2}
SIGHT = {
    "on_tool": True, "points_m": [[0.0, 0.0, 0.0]], "low": [-0.5, -0.3], "high": [0.5, 0.3],
    "focal": [900.0, 900.0],
}  # fmt: skip
FIT = {
    "when": "2026-01-01T00:00:00+00:00", "tool_version": "0.1.0", "arm_sha256": "0" * 64,
    "data": [{"path": "d.csv", "sha256": "0" * 64}], "poses": 20, "components": 3, "noise_scale": 1.0,
    "base": FRAME, "tool": FRAME, "sight": SIGHT, "expected": EXPECTED,
}  # fmt: skip
VALUES = [{"name": "a.k", "value": 1.0, "std_err": 0.1}]
# What the shipped files leave out, and the kinds without a shipped file.
ALSO = {
    "arm": {"target": {"points_m": [[0.0, 0.0, 0.0]]}},
    "data-map": {
        "columns": {}, "units": {}, "rotation": {"form": "xyzw", "columns": "quat{}"},
        "targets": {"columns": [["X", "Y", "Z"]]}, "text": {}, "ros": {},
    },
    "model": {
        "history": [{"when": "2026-01-01T00:00:00+00:00", "action": "add", "effects": ["a"], "before": []}],
        "value": VALUES,
        "fit": FIT,
        "former": {"effects": ["a"], "value": VALUES, "fit": FIT},
        "unnamed": [
            {
                "name": "unnamed[joint 1: q2]",
                "parameter": [
                    {"name": "c1", "sigma": 1e-3, "term": [{"at": "joint[1]", "basis": "sin(q2)"}]}
                ],
            }
        ],
    },
    "scenario": {
        "arm": {"coupling": [{"name": "odd", "joint": "J1", "size_rad": 0.1, "tanh": "J2", "cos": "J3"}]},
        "env": {}, "optics": {}, "detection": {}, "calibration": {}, "executive": {}, "expect": {},
    },
}  # fmt: skip


@cache
def example(kind):
    """A document in which every table of the kind occurs."""
    doc = read_toml(SHIPPED[kind]) if kind in SHIPPED else {}
    if kind == "effects":  # one is enough
        doc = {"effect": [e for e in doc["effect"] if e["name"] == "joint_compliance"]}
    return doc | ALSO.get(kind, {})


def tables_of(model, doc, path=()):
    """(model, path to it) of the first table of every model in a document."""
    yield model, path
    for key, field in base.keys_of(model).items():
        inner = base.model_of(field.annotation)
        of_list = base.model_of(base.item_annotation(field.annotation))
        if inner and key in doc:
            yield from tables_of(inner, doc[key], (*path, key))
        elif of_list and doc.get(key):
            yield from tables_of(of_list, doc[key][0], (*path, key, 0))


def all_keys():
    for kind, model in files.FILES.items():
        for table, path in tables_of(model, example(kind)):
            for key, field in base.keys_of(table).items():
                yield kind, path, key, field


KEYS = [
    pytest.param(kind, path, key, field, id=f"{kind}:{errors.path_text((*path, key))}")
    for kind, path, key, field in all_keys()
]
REQUIRED = [p for p in KEYS if p.values[3].is_required()]


def models_in(model):
    found = {model}
    for field in model.model_fields.values():
        for annotation in (field.annotation, base.item_annotation(field.annotation)):
            inner = base.model_of(annotation)
            if inner:
                found |= models_in(inner)
    return found


def change(kind, path, edit):
    """The example with its table at `path` edited; the problems found in it."""
    doc = copy.deepcopy(example(kind))
    table = doc
    for part in path:
        table = table[part]
    edit(table)
    with pytest.raises(SchemaError) as error:
        validate(files.FILES[kind], doc, "here.toml")
    assert error.value.where == "here.toml"
    return error.value.problems


def refuses(kind, text, tmp_path):
    path = tmp_path / f"{kind}.toml"
    path.write_text(text)
    with pytest.raises(BadInput) as error:
        validate(files.FILES[kind], read_toml(path), str(path))
    return str(error.value)


@pytest.mark.parametrize("kind", files.FILES)
def test_example_holds_every_table_of_its_kind_and_is_valid(kind):
    validate(files.FILES[kind], example(kind), kind)
    assert {model for model, _ in tables_of(files.FILES[kind], example(kind))} == models_in(files.FILES[kind])


@pytest.mark.parametrize(("kind", "path", "key", "_field"), KEYS)
def test_typing_slip_in_any_key_is_refused_and_the_key_named(kind, path, key, _field):
    slips = [key + key[-1]] + ([key[:1] + key[2] + key[1] + key[3:]] if len(key) > 5 else [])
    for slip in (slip for slip in slips if slip != key):
        problems = change(kind, path, lambda t, slip=slip: t.update({slip: t.pop(key, 1)}))
        found = {p.path: p for p in problems}
        at = errors.path_text((*path, slip))
        at = next(p for p in found if p.split(" (")[0] == at)
        assert found[at].what == "unknown key"
        assert found[at].right == errors.path_text((*path, key)), found[at]
        assert key in found[at].todo


@pytest.mark.parametrize(("kind", "path", "key", "_field"), REQUIRED)
def test_any_required_key_that_is_missing_is_refused_by_its_path(kind, path, key, _field):
    problems = change(kind, path, lambda t: t.pop(key))
    assert errors.path_text((*path, key)) in [p.path for p in problems if "is missing" in p.what]
    assert all(p.todo for p in problems if "is missing" in p.what)


@pytest.mark.parametrize(("kind", "path", "key", "field"), KEYS)
def test_wrong_type_of_any_key_is_refused_by_its_path(kind, path, key, field):
    takes_table = base.model_of(field.annotation) or "dict" in str(field.annotation)
    problems = change(kind, path, lambda t: t.update({key: 3 if takes_table else {"odd": "thing"}}))
    at = errors.path_text((*path, key))
    assert any(p.path.startswith(at) for p in problems), problems


@pytest.mark.parametrize("kind", files.FILES)
def test_every_key_of_every_file_is_documented(kind):
    schema = json.loads(files.json_schema(kind))
    for table in [schema, *schema.get("$defs", {}).values()]:
        for key, about in table["properties"].items():
            assert about.get("description") or "$ref" in about, (kind, key)
        assert table["additionalProperties"] is False


# --------------------------------------------------------------------------- the arm, key by key

ARM = SHIPPED["arm"].read_text()


def arm_with(tmp_path, old, new):
    assert old in ARM
    path = tmp_path / "arm.toml"
    path.write_text(ARM.replace(old, new, 1))
    with pytest.raises(SchemaError) as error:
        arm.read_arm(path)
    assert error.value.where == str(path)
    return error.value.what


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        (
            "alpha_rad = -1.5707963267948966", "alpha_deg = -90",
            "joint[1].alpha_deg: unknown key; write alpha_rad in radians: alpha_rad = -1.5708",
        ),
        ("d_m = 0.55", "d_mm = 550", "joint[3].d_mm: unknown key; write d_m in metres: d_m = 0.55"),
        ("estimate = false", "estimated = true", "base.estimated: unknown key; write estimate = true"),
        (
            'convention = "standard"\n', "",
            'convention: is missing; write convention = "standard" or convention = "modified"',
        ),
        (
            "gear_ratio = 42.0", "gear_ration = 42.0",
            "joint[1].gear_ration: unknown key; write gear_ratio = 42.0",
        ),
        (
            'convention = "standard"', 'convention = "modifed"',
            'convention: is "modifed"; write "standard" or "modified"; nearest is "modified"',
        ),
        (
            "alpha_rad = -1.5707963267948966", "alpha = -1.57",
            "joint[1].alpha: unknown key; write alpha_rad (in radians)",
        ),
        ("phi_rad = 0.0", "theta_rad = 0.0", "joint[1].theta_rad: unknown key; write phi_rad"),
        ("a_m = 0.045", "a_m = nan", "joint[3].a_m: is nan, a finite number is needed"),
        ("a_m = 0.045", "a_m = true", "joint[3].a_m: a number is needed"),
        ("a_m = 0.045", 'a_m = "4 cm"', "joint[3].a_m: cannot work out '4 cm'; use numbers"),
        ("q_max_rad = 2.0", "q_max_rad = -2.0", "joint[2].q_min_rad: is -2, which is not below q_max_rad -2"),
        (
            "q_min_rad = -2.6", "q_min_m = -2.6",
            "joint[1].q_min_m: is in metres, but the joint is revolute; write q_min_rad, or type = ",
        ),
        (
            "mass_kg = 1.8023\ncom_m = [-0.03826, 0.20751, 3e-05]\n",
            "",
            "joint[3].mass_kg: is missing, but other joints have masses; give every joint mass_kg and com_m",
        ),
        (
            "com_m = [-0.03826, 0.20751, 3e-05]\n", "",
            "joint[3].com_m: is missing beside mass_kg; write both or neither",
        ),
        (
            "quat_wxyz = [1.0, 0.0, 0.0, 0.0]", "quat_wxyz = [1.0, 0.1, 0.0, 0.0]",
            "base.quat_wxyz: has norm 1.00499, 1 is needed",
        ),
        (
            "quat_wxyz = [1.0, 0.0, 0.0, 0.0]",
            "quat_xyzw = [0.5, 0.1, 0.0, 1.0]",
            "base.quat_xyzw: unknown key; write quat_wxyz, the scalar part first: quat_wxyz = [1.0, 0.5,",
        ),
        ("xyz_m = [0.0, 0.0, 0.346]", "xyz_m = [0.0, 0.346]", "base.xyz_m: has 2 entries, 3 are needed"),
        ("[sensor]", "[camera]", "camera: unknown key; cx_px, cy_px, fx_px, fy_px belong in [sensor]"),
        ("fx_px = 1397.0\n", "", "sensor.fx_px: is missing; fx_px, fy_px, cx_px, cy_px belong together"),
        (
            "[sensor]", "[sensor]\ngravity_m_s2 = [0, 0, -1.3]",
            "sensor.gravity_m_s2: unknown key; gravity_m_s2 belongs at the top of the file, above the",
        ),
        (
            "alpha_rad = -1.5707963267948966", "alpha_rad = -90",
            "joint[1].alpha_rad: is -90, must be -6.28319 or more; in radians, -90 degrees are -1.5708",
        ),
        (
            "estimate = false", 'estimate = "true"',
            'base.estimate: is "true", true or false is needed; write true without quotes',
        ),
    ],
)  # fmt: skip
def test_wrong_arm_is_refused_with_path_and_what_to_write(tmp_path, old, new, what):
    assert arm_with(tmp_path, old, new).startswith(what)


def test_all_problems_of_a_file_are_said_at_once(tmp_path):
    text = ARM.replace('convention = "standard"\n', "").replace("d_m = 0.55", "d_mm = 550")
    (tmp_path / "arm.toml").write_text(text.replace("a_m = -0.045", 'a_m = "x"'))
    with pytest.raises(SchemaError) as error:
        arm.read_arm(tmp_path / "arm.toml")
    assert [p.path for p in error.value.problems] == ["convention", "joint[3].d_mm", "joint[4].a_m"]
    assert error.value.what.startswith("3 problems:\n")


def test_a_file_that_is_none_is_refused(tmp_path):
    (tmp_path / "broken.toml").write_text("name = ")
    for name, what in (("broken.toml", "not valid TOML"), ("none.toml", "no such file"), ("", "directory")):
        with pytest.raises(BadInput, match=what):
            arm.read_arm(tmp_path / name)


def test_numbers_may_be_expressions_in_every_file(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(ARM.replace("alpha_rad = -1.5707963267948966", 'alpha_rad = "-pi/2"'))
    assert arm.read_arm(path).joints[0].alpha_rad == arm.read_arm("wam").joints[0].alpha_rad


def test_sensor_and_target_are_kept(tmp_path):
    path = tmp_path / "arm.toml"
    more = 'mount = "tool"\nwidth_px = 640\nheight_px = 480\n'
    path.write_text(
        ARM.replace("[sensor]\n", "[target]\npoints_m = [[0, 0, 0], [0.1, 0, 0]]\n[sensor]\n" + more)
    )
    read = arm.read_arm(path)
    assert (read.mount, read.camera.fx_px, read.camera.width_px) == ("tool", 1397.0, 640.0)
    assert read.target_points_m.tolist() == [[0, 0, 0], [0.1, 0, 0]]


def test_sixteen_joints_are_read_and_seventeen_refused(tmp_path):
    head, joint = ARM.split("[[joint]]")[0], "[[joint]]" + ARM.split("[[joint]]")[1]
    path = tmp_path / "arm.toml"
    path.write_text(head + joint * 16)
    assert arm.read_arm(path).n == 16
    path.write_text(head + joint * 17)
    with pytest.raises(SchemaError, match="joint: has 17 entries, there is room for 16"):
        arm.read_arm(path)


def test_prismatic_joint_takes_its_limits_in_metres(tmp_path):
    path = tmp_path / "arm.toml"
    text = ARM.replace('type = "revolute"', 'type = "prismatic"', 1)
    path.write_text(text.replace("q_min_rad = -2.6\nq_max_rad = 2.6", "q_min_m = 0\nq_max_m = 0.3", 1))
    joint = arm.read_arm(path).joints[0]
    assert (joint.prismatic, joint.q_min, joint.q_max) == (True, 0.0, 0.3)


# --------------------------------------------------------------------------- what is shipped


@pytest.mark.parametrize("kind", SHIPPED)
def test_shipped_file_reads_and_names_its_schema(kind):
    validate(files.FILES[kind], read_toml(SHIPPED[kind]), kind)
    hint = SHIPPED[kind].read_text().splitlines()[0].removeprefix("#:schema ")
    assert (SHIPPED[kind].parent / hint).resolve() == ROOT / "build" / "schema" / f"{kind}.schema.json"


@pytest.mark.parametrize("path", sorted((ROOT / "sim/scenarios").glob("*.toml")), ids=lambda p: p.stem)
def test_shipped_scenario_reads(path):
    assert scenario.read_scenario(path).name == path.stem
    assert path.read_text().startswith("#:schema ../../build/schema/scenario.schema.json\n")


def test_shipped_library_reads():
    assert len(Library.load().effects) > 20


@pytest.mark.parametrize("path", sorted(DATA.glob("*/*.toml")), ids=lambda p: p.stem)
def test_arm_of_real_data_reads(path):
    read = arm.read_arm(path)
    assert read.n in (6, 7)
    assert read.mount == ("tool" if "fr3" in path.name else "world")


def test_every_toml_of_the_project_is_of_a_known_kind():
    known = {*SHIPPED.values(), *(ROOT / "sim/scenarios").glob("*.toml"), ROOT / "ground/pyproject.toml"}
    known |= set((ROOT / "ground/kincal_shared/arms").glob("*.toml"))  # test_arms reads each
    places = ("ground/kincal", "ground/kincal_shared", "sim", "tables/src")
    found = {p for place in places for p in (ROOT / place).rglob("*.toml") if "ruff" not in p.name}
    assert found <= known


def test_schema_of_a_kind_is_shown_and_all_are_written(tmp_path):
    shown = shell("schema", "scenario")
    assert json.loads(shown.output)["$id"] == "scenario.schema.json"
    assert shell("schema", "-o", tmp_path).exit_code == 0
    assert {p.name.split(".")[0] for p in tmp_path.iterdir()} == set(files.FILES)
    assert (tmp_path / "scenario.schema.json").read_text() == shown.output


def test_kinds_of_files_are_listed_each_with_what_it_is():
    lines = shell("schema").output.splitlines()
    assert [line.split()[0] for line in lines] == sorted(files.FILES)
    assert all(len(line.split()) > 2 for line in lines)


@pytest.mark.parametrize(
    ("given", "complaint"),
    [(["arms"], "no kind of file 'arms'; there are arm,"), (["arm", "-o", "x"], "or -o FOLDER to write all")],
)
def test_a_wrong_question_for_a_schema_says_what_there_is(given, complaint):
    asked = shell("schema", *given)
    assert asked.exit_code == 2
    assert complaint in text_of(asked)


# --------------------------------------------------------------------------- the headers say the same


def test_limits_are_those_of_the_headers():
    lib = library("flight").lib
    assert (space.CAND_MAX, space.HUB_MAX, space.INITIAL_MAX, space.STOP_MAX) == (
        lib.KC_CAND_MAX, lib.KC_HUB_MAX, lib.KC_INITIAL_MAX, lib.KC_STOP_MAX,
    )  # fmt: skip
    assert space.JOINT_MAX == tables.JOINT_MAX == lib.KC_JOINT_MAX
    assert (tables.COEF_MAX, tables.NAME_CHARACTERS) == (lib.KC_COEF_MAX, lib.KC_NAME_LEN - 1)
    assert library("ground").lib.KC_JOINT_MAX >= arm.MAX_JOINTS


@pytest.mark.parametrize(
    ("model", "struct", "differs"),
    [
        (tables.ArmSource, "kc_arm_t", {"n_joints"}),
        (tables.ArmSourceJoint, "kc_joint_t", {"has_mass", "joint_name"}),
        (tables.CameraSource, "kc_camera_t", {"n_tags"}),
        (tables.TagEntry, "kc_tag_t", set()),
        (tables.KernelSource, "kc_kernel_t", {"n_hyper", "hyper", "set"}),
        (tables.KernelSet, "kc_hyper_t", {"n_w", "w", "trunc_err"}),
        (tables.KinSource, "kc_kin_t", set()),
        (tables.ConfigSource, "kc_config_t", set()),
        (tables.ServoBlock, "kc_servo_opt_t", set()),
        (tables.EstimatorBlock, "kc_est_opt_t", set()),
        (tables.CoefEntry, "kc_coef_t", {"joints", "term"}),
    ],
)
def test_source_has_the_fields_of_its_struct(model, struct, differs):
    fields = {name for name, _ in library("flight").ffi.typeof(struct).fields}
    assert fields ^ set(model.model_fields) == differs | (
        set(model.model_fields) & {"kind", "title", "provenance"}
    )


@pytest.mark.parametrize(
    ("model", "key", "enum", "prefix"),
    [
        (tables.ArmSourceJoint, "type", "kc_joint_type_t", "KC_"),
        (tables.ConfigSource, "acquisition", "kc_acq_t", "KC_ACQ_"),
        (tables.ConfigSource, "frame", "kc_right_in_t", "KC_RIGHT_IN_"),
        (tables.KernelSource, "arg", "kc_kernel_arg_t", "KC_KERNEL_"),
        (space.KeepOut, "kind", "kc_volume_kind_t", "KC_VOL_"),
    ],
)
def test_names_of_a_key_are_those_of_the_headers(model, key, enum, prefix):
    names = base.choices_of(model.model_fields[key].annotation)
    assert sorted(names) == sorted(name.lower() for name in library("flight").enum(enum, prefix))


def test_acquisitions_stand_in_the_order_of_their_numbers():
    assert [name.upper() for name in ACQUISITIONS] == list(library("flight").enum("kc_acq_t", "KC_ACQ_"))


# --------------------------------------------------------------------------- other files


@pytest.mark.parametrize(
    ("kind", "text", "what"),
    [
        ("model", 'effects = ["base_flex", "base_flex"]', "effects: names base_flex twice"),
        ("model", 'effects = ["backlash", "backlash[2]"]', "backlash, which is the effect at all joints"),
        ("model", 'effects = ["joint_ripple[2](k=4)"]\n[constants."joint_ripple[2]"]\nk = 3',
         'constants."joint_ripple[2]".k: is 3, but effects says k=4'),
        ("model", 'effects = ["joint_ripple(k=4)"]\n[constants."joint_ripple[2]"]\nk = 3',
         "is 3, but effects says k=4"),
        ("model", 'effects = "backlash"', 'effects: is "backlash", a list is needed'),
        ("model", "effect = []", "effect: unknown key; write effects"),
        ("scenario", '[arm.errors]\n"J7.phi_deg" = 75', "arm.errors: 'J7.phi_deg' is no error; they are"),
        ("scenario", "[arm.encoder_gain]\nj4 = 0.1", "arm.encoder_gain: 'j4' is no joint; they are"),
        ("scenario", '[executive]\naccept = "Ground"', 'nearest is "ground"'),
        ("scenario", '[expect]\nheld_out_pos_mm = 2', "in metres: held_out_pos_m = 0.002"),
        ("scenario", "[detection]\nnoise = \"pink\"", 'write "corners" or "isotropic"'),
        ("effects", "", "effect: is missing"),
        ("effects", '[[effect]]\nname = "a"', "effect[1].parameter: is missing"),
    ],
)  # fmt: skip
def test_wrong_file_is_refused_with_path_and_what_to_write(tmp_path, kind, text, what):
    assert what in refuses(kind, text, tmp_path)


MINE = """[[effect]]
name = "mine"
per = "joint"
[[effect.parameter]]
name = "k"
sigma = 1e-3
[[effect.parameter.term]]
at = "joint[j]"
basis = "q[j]"
"""


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('basis = "q[j]"', 'basis = "sinh(q[j])"', "'sinh' is no function; there are lin, sin"),
        (
            'basis = "q[j]"', 'basis = "q[i]"',
            'basis (mine): names joint i, which per = "joint" does not have',
        ),
        (
            'basis = "q[j]"', 'basis = "t/$tau"',
            "uses $tau, which has no value; add it to [effect.grid]: tau = [...]",
        ),
        ('at = "joint[j]"', 'at = "elbow"', "at = 'elbow' is no place; write one of joint[j]"),
        ('at = "joint[j]"', 'at = "link[j]"', "comp (mine): is missing; write comp = one of tx, ty"),
        ('at = "joint[j]"', 'at = "joint[j]"\ncomp = "rx"', "joint[j] has its own axis and takes no comp"),
        (
            'basis = "q[j]"',
            'gain = "2*Lw"',
            "gain '2*Lw': 'Lw' is neither a number, nor a $constant, nor one of",
        ),
        ("sigma = 1e-3", "sigma = 0", "sigma (mine): is 0, must be above 0"),
        (
            'per = "joint"', 'per = "joint"\nneeds = ["warmth"]',
            "'warmth' is nothing that data or arm tables hold",
        ),
        (
            'per = "joint"', 'per = "joint"\npairs = [[1, 2]]',
            'pairs (mine): stands in an effect with per = "joint"',
        ),
        (
            'per = "joint"', 'per = "joint"\nequivalent = "x"',
            "equivalent (mine): unknown key; write equivalent_to",
        ),
    ],
)  # fmt: skip
def test_wrong_effect_is_refused_by_its_name(tmp_path, old, new, what):
    assert old in MINE
    path = tmp_path / "mine.toml"
    path.write_text(MINE.replace(old, new, 1))
    with pytest.raises(SchemaError) as error:
        Library.load(path)
    assert what in error.value.what
    assert "effect[1]" in error.value.what and "(mine)" in error.value.what


def test_two_effects_of_one_name_are_refused(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(MINE + MINE)
    with pytest.raises(SchemaError, match="as another effect's"):
        Library.load(path)
    assert tomllib.loads(MINE)
