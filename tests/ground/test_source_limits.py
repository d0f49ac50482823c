"""Sources of tables at their limits: what a value may be, what is left out, and terms of each joint."""

import math
import shutil
import tomllib

import pytest
from commands import shell
from places import BIN, SRC

from kincal import tables
from kincal.api import tables as api
from kincal.flight import library
from kincal.flight import tables as codec
from kincal.flight.terms import FRAMES, fill_basis, variable
from kincal_shared.errors import BadInput, KincalError
from kincal_shared.schema import base, numbers
from kincal_shared.schema import tables as sources
from kincal_shared.schema.errors import SchemaError, validate
from kincal_shared.schema.names import PNP
from kincal_shared.schema.terms import Basis, TermEntry, parse_basis, parse_gain, split_product

FLIGHT = library("flight")
GIVEN = {kind: tomllib.loads((SRC / f"{kind}.toml").read_text()) for kind in sources.SOURCES}


def of(kind, path, value):
    """The shipped source with one value changed; path: keys and numbers of entries."""
    doc = tomllib.loads((SRC / f"{kind}.toml").read_text())
    *inner, last = path
    table = doc
    for key in inner:
        table = table[key]
    table[last] = value
    return validate(sources.SOURCES[kind], doc, "here")


LIMITS = [
    ("config", ("n_poses",), (0, 1), (-1,)),
    ("config", ("settle_us",), (0,), (-1,)),
    ("config", ("accept_on_board",), (0, 1), (-1, 2)),
    ("config", ("est", "free_mask"), (0, 2**64 - 1), (-1, 2**64)),
    ("config", ("frame",), ("camera", "lander"), ("base",)),
    ("kin", ("arm_crc",), (0, 2**32 - 1), (-1, 2**32)),
    ("kin", ("n_coef",), (0, sources.COEF_MAX), (-1, sources.COEF_MAX + 1)),
    ("kernel", ("choose",), (0, 1), (-1, 2)),
    ("kernel", ("set", 0, "nu"), (0, [0, 1.5]), (-0.1, [0, -0.1])),
    ("kernel", ("set", 0, "kappa"), (1e-3, [1e-3]), (0, [0.1, 0])),
    ("camera", ("tag", 0, "id"), (0, 1), (-1,)),
    ("camera", ("tag", 0, "size_m"), (1e-3,), (0, -1e-3)),
    ("camera", ("pan_min_rad",), (-2 * math.pi,), (-6.3,)),
    ("camera", ("pan_max_rad",), (2 * math.pi,), (6.3,)),
    ("camera", ("mast_sigma_m",), (0,), (-1e-9,)),
    ("arm", ("joint", 0, "alpha_rad"), (-2 * math.pi, 2 * math.pi), (-6.3, 6.3)),
    ("arm", ("joint", 0, "mass_kg"), (0, 1), (-1e-9,)),
    ("arm", ("joint", 0, "q_max"), (2.0,), (-2.6, -2.7, math.nan, math.inf, True)),
    ("camera", ("pan_min_rad",), (1.59,), (1.6, 1.61)),
    ("camera", ("tilt_min_rad",), (1.39,), (1.4,)),
    ("arm", ("name",), ("x" * 23,), ("", "x" * 24)),
    ("terms", ("dh", "joints"), (7,), (0, 9)),
    ("terms", ("coef", 0, "scale"), (1e-9,), (0,)),
    ("terms", ("coef", 0, "term"), (), ([],)),
]


@pytest.mark.parametrize(("kind", "path", "good", "bad"), LIMITS)
def test_a_value_may_be_what_its_limits_say_and_no_more(kind, path, good, bad):
    for value in good:
        found = of(kind, path, value)
        for key in path:
            found = found[key] if isinstance(key, int) else getattr(found, key)
        assert found == value
    for value in bad:
        with pytest.raises(SchemaError) as error:
            of(kind, path, value)
        assert error.value.problems[0].path.startswith(path[0])


@pytest.mark.parametrize(
    ("kind", "path", "entry", "fewest", "most"),
    [("arm", ("joint",), 0, 1, 8), ("camera", ("tag",), 0, 1, 4), ("kernel", ("set",), 0, 1, 99)],
)
def test_lists_have_as_many_entries_as_the_table_has_room_for(kind, path, entry, fewest, most):
    row = GIVEN[kind][path[0]][entry]
    for count in (fewest, most):
        assert len(getattr(of(kind, path, [row] * count), path[0])) == count
    for count in (fewest - 1, *([most + 1] if most < 99 else [])):
        with pytest.raises(SchemaError):
            of(kind, path, [row] * count)


@pytest.mark.parametrize("joints", [[1], [8], [0], [9]])
def test_joints_of_a_coefficient_count_from_1_to_8(joints):
    coef = {**GIVEN["terms"]["coef"][0], "joints": joints}
    if joints[0] in (1, 8):
        assert of("terms", ("coef",), [coef]).coef[0].joints == joints
    else:
        with pytest.raises(SchemaError):
            of("terms", ("coef",), [coef])


def test_what_other_sources_leave_out_means_nothing_special():
    """As docs/TABLES.md says: an unknown gear, any arm, DH errors that are estimated."""
    joint = {k: v for k, v in GIVEN["arm"]["joint"][0].items() if k not in ("gear_ratio", "joint_name")}
    found = of("arm", ("joint",), [joint]).joint[0]
    assert (found.gear_ratio, found.joint_name) == (0.0, "")
    doc = {k: v for k, v in GIVEN["terms"].items() if k not in ("kinematics_crc", "title", "provenance")}
    doc["dh"] = {k: v for k, v in doc["dh"].items() if k != "enabled"}
    terms = validate(sources.TermsSource, doc, "here")
    assert (terms.kinematics_crc, terms.dh.enabled, terms.title, terms.provenance) == (0, True, "", {})
    assert validate(sources.TermsSource, {"kind": "terms"}, "here").coef == []


def test_what_config_leaves_out_is_built_as_the_shipped_table_has_it(tmp_path):
    required = {k for k, f in sources.ConfigSource.model_fields.items() if f.is_required()}
    lines, keep = (SRC / "config.toml").read_text().splitlines(), []
    for line in lines:
        key = line.partition("=")[0].strip()
        in_block = any(x.startswith(("[servo]", "[est]")) for x in keep)
        keep += [line] if in_block or key in required or key not in sources.ConfigSource.model_fields else []
    assert len(keep) < len(lines) - 10
    path = tmp_path / "config.toml"
    path.write_text("\n".join(keep) + "\n")
    assert tables.build(path).data == (BIN / "config.tbl").read_bytes()


# --------------------------------------------------------------------------- terms of each joint


def terms_of(tmp_path, joints, *terms):
    text = 'kind = "terms"\n[[coef]]\nname = "x[{j}]"\nlb = -1.0\nub = 1.0\nprior_sigma = 0.0\nscale = 1.0\n'
    rows = ", ".join(f"{{ {term} }}" for term in terms)
    path = tmp_path / "terms.toml"
    path.write_text(f"{text}enabled = true\njoints = {joints}\nterm = [{rows}]\n")
    return tables.readable(codec.decode(tables.build(path).data)[1])


def test_j_is_the_joint_and_p_the_one_before_it_in_places_and_bases(tmp_path):
    doc = terms_of(
        tmp_path, [3, 5],
        'at = "link[p]", comp = "tx", basis = "q[p] * cos(q[j])"',
        'at = "joint[j]", gain = -2',
    )  # fmt: skip
    assert [c["name"] for c in doc["coef"]] == ["x[3]", "x[5]"]
    assert [(t["coef"], t["at"], t["comp"], t["gain"], t["basis"]) for t in doc["term"]] == [
        (0, "link[2]", "tx", 1.0, "q2 * cos(q3)"), (0, "link[2]", "rz", -2.0, "1"),
        (1, "link[4]", "tx", 1.0, "q4 * cos(q5)"), (1, "link[4]", "rz", -2.0, "1"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("term", "what"),
    [
        ('at = "link[i]", comp = "tx"', "names joint i"),
        ('at = "joint[j]", basis = "q[k]"', "names joint k"),
        ('at = "joint[j]", gain = "2*Lx"', "is '2\\*Lx'"),
        ('at = "joint[j]", basis = "N*q[j]"', "uses a constant by name"),
        ('at = "joint[j]", basis = "q[j]-$t"', "uses a constant by name"),
        ('at = "joint[j]", comp = "tx"', "takes no comp"),
        ('at = "tool"', "comp.* is missing"),
    ],
)
def test_a_term_of_a_table_has_nothing_open(tmp_path, term, what):
    with pytest.raises(KincalError, match=what):
        terms_of(tmp_path, [1], term)


def test_a_term_without_joints_has_no_letters():
    entry = {"name": "x", "lb": -1.0, "ub": 1.0, "prior_sigma": 0.0, "scale": 1.0, "enabled": True}
    for at, good in (("link[2]", True), ("link[j]", False), ("link[p]", False)):
        doc = {"kind": "terms", "coef": [{**entry, "term": [{"at": at, "comp": "tx"}]}]}
        if good:
            assert validate(sources.TermsSource, doc, "here").coef[0].joints is None
        else:
            with pytest.raises(SchemaError, match="names joint"):
                validate(sources.TermsSource, doc, "here")


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("2*q1*cos(q2)", ["2*q1", "cos(q2)"]), ("cos(2*q1) * 3*q2", ["cos(2*q1)", "3*q2"]),
        ("q1 * 1.5e-3*q2", ["q1", "1.5e-3*q2"]), ("N*q1*temp", ["N*q1", "temp"]),
        ("sin((q1-1)*2)", ["sin((q1-1)*2)"]),
    ],
)  # fmt: skip
def test_a_product_is_split_between_its_factors_only(text, parts):
    assert split_product(text) == parts


@pytest.mark.parametrize(
    ("text", "basis"),
    [
        ("4*q1+2", Basis("lin", "q", 1, -0.5, 4.0)), ("1.5*q1-3", Basis("lin", "q", 1, 2.0, 1.5)),
        ("4*(q1+2)", Basis("lin", "q", 1, -2.0, 4.0)),
        ("(q1-2)/4", Basis("lin", "q", 1, 2.0, 0.25)), ("q1/4", Basis("lin", "q", 1, 0.0, 0.25)),
        ("3*q1/4", Basis("lin", "q", 1, 0.0, 0.75)), ("q1-2", Basis("lin", "q", 1, 2.0, 1.0)),
    ],
)  # fmt: skip
def test_offset_and_scale_are_those_of_the_text(text, basis):
    assert parse_basis(text, {})[0] == basis
    assert parse_basis(basis.exact(), {})[0] == basis
    assert parse_basis(str(basis), {})[0] == basis


def test_levers_have_a_link_and_a_body():
    one, tool = parse_basis("levx[2,5] * levz[3,tool]", {})
    assert (str(one), str(tool), one.highest_link, tool.highest_link) == ("levx[2,5]", "levz[3,tool]", 5, 3)
    assert parse_basis("levx[p,k]", {"p": 1.0, "k": 4.0})[0] == parse_basis("levx[1,4]", {})[0]
    assert parse_basis("q7", {})[0].highest_link == 7 and parse_basis("temp", {})[0].highest_link == 0
    for text in ("levx[1,x]", "levx[x,1]", "levx[tool,1]", "q[tool]"):
        with pytest.raises(BadInput, match="no joint"):
            parse_basis(text, {})


def test_needs_are_those_of_any_factor_and_of_the_place():
    assert list(TermEntry(at="base", comp="tx", basis="q1 * cos(N*q1)").needs()) == ["gear_ratio"]
    assert list(TermEntry(at="base", comp="tx", basis="q1 * q2").needs()) == []
    assert parse_basis("temp", {})[0].need == "temp_c" and parse_basis("q1", {})[0].need is None
    factors = TermEntry(at="joint[j]", basis="levx[p,k] * q1").factors
    assert [factor.letters() for factor in factors] == [["p", "k"], []]


@pytest.mark.parametrize(
    ("text", "factor", "symbols"),
    [
        ("2", 2.0, ()), ("+2*-3", -6.0, ()), ("Lx*-Ly", -1.0, ("Lx", "Ly")),
        ("2*a*0.5*long", 1.0, ("a", "long")),
    ],
)  # fmt: skip
def test_gains_multiply(text, factor, symbols):
    assert parse_gain(text) == (factor, symbols)


def test_every_variable_of_points_and_sensor_is_one_of_the_headers():
    number = library("ground").enum("kc_var_t", "KC_VAR_")
    assert {name: variable(name) for name in PNP} == {n: number[f.upper()] for n, f in PNP.items()}
    assert [variable(x) for x in ("1", "taup", "sx", "sy", "sz")] == [
        number[x] for x in ("ONE", "TAU_PAYLOAD", "XCAM", "YCAM", "ZCAM")
    ]
    row = library("ground").new("kc_basis_t")
    fill_basis(row, Basis("cos", "q", 3, 0.5, 2.0))
    assert (row.index, row.c0, row.c1) == (3, 0.5, 2.0)
    assert (FRAMES["sensor"], FRAMES["tool"], FRAMES["meas"]) == (FRAMES["camera"], -3, -1)


# --------------------------------------------------------------------------- numbers and texts


@pytest.mark.parametrize(
    "text",
    [
        "True", "'1'", "sin(1, 2)", "sin(x=1)", "tan(1)", "1e999", "1 // 2", "~1", "", "1e308*10", "q", "1/0",
        "__import__('os')", "pi(", "(1).real", "10**10**10**10", "[1]",
    ],
)  # fmt: skip
def test_what_is_no_number_is_refused_with_what_is_possible(text):
    with pytest.raises(BadInput, match="cannot work out") as error:
        numbers.number(text, "there")
    assert error.value.where == "there" and error.value.todo.startswith("use numbers")


def test_lengths_are_below_ten_thousand_kilometres():
    class Model(base.Strict):
        place: numbers.Place

    for x, good in ((1e7, True), (-1e7, True), (1.1e7, False), (-1.1e7, False)):
        doc = {"place": (x, 0.0, 0.0)}
        if good:
            assert validate(Model, doc, "here").place[0] == x
        else:
            with pytest.raises(SchemaError):
                validate(Model, doc, "here")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (True, "true"), (2.0, "2.0"), (1e14, "100000000000000.0"), (1e15, "1e+15"), (-1e15, "-1e+15"),
        (0.1, "0.1"), (math.inf, "inf"), (3, "3"), ([1, "a"], '[1, "a"]'),
        ({"x": 1.5, "y": False}, "{ x = 1.5, y = false }"),
    ],
)  # fmt: skip
def test_values_are_shown_as_toml_has_them(value, text):
    assert base.toml_text(value) == text


def test_annotations_say_what_a_key_takes():
    keys = base.keys_of(sources.ArmSource)
    assert base.fixed_length(keys["gravity_m_s2"].annotation) == 3
    assert base.fixed_length(keys["joint"].annotation) == 0 == base.fixed_length(tuple[int, ...])
    assert base.model_of(base.item_annotation(keys["joint"].annotation)) is sources.ArmSourceJoint
    assert base.item_annotation(dict[str, int]) is int and base.item_annotation(int) is None
    assert base.model_of(sources.DhBlock | None) is sources.DhBlock and base.model_of(int) is None
    assert base.choices_of(keys["kind"].annotation) == ["arm"] and base.choices_of(int) == []
    assert base.annotation_of(None, "x") is None is base.annotation_of(sources.ArmSource, "nothing")


# --------------------------------------------------------------------------- files


def test_sources_of_a_folder_are_built_in_order_spaces_last():
    paths = [SRC / f"{kind}.toml" for kind in ("space", "terms", "arm")]
    assert [p.stem for p in tables.build_order(paths)] == ["arm", "terms", "space"]


def test_what_cannot_be_read_or_is_no_source_is_said(tmp_path):
    with pytest.raises(BadInput, match="cannot read: No such file") as error:
        tables.load(tmp_path / "x.tbl")
    assert error.value.where == str(tmp_path / "x.tbl")
    source = tmp_path / "x.toml"
    source.write_text("title = 'a'\n")
    with pytest.raises(BadInput, match="^kind: is missing") as error:
        tables.source_kind(source)
    assert error.value.todo.endswith('kind = "config" or kind = "space"') and error.value.where == str(source)


def test_one_source_is_built_into_its_file_whose_folder_is_made(tmp_path):
    ((out, image),) = api.build_files(SRC / "kin.toml", tmp_path / "a" / "b.tbl")
    assert (out, image.kind) == (tmp_path / "a" / "b.tbl", "kin")
    assert out.read_bytes() == (BIN / "kin.tbl").read_bytes() == image.data


def test_a_space_is_built_for_the_tables_that_are_named_or_those_beside_it(tmp_path, monkeypatch):
    seen = []

    def build(_source, folder):
        seen.append(folder)
        return codec.decode((BIN / "kin.tbl").read_bytes())[0]

    monkeypatch.setattr(api, "build", build)
    for given in (None, BIN):
        list(api.build_files(SRC / "space.toml", tmp_path / "space.tbl", given))
    assert seen == [tmp_path, BIN]


def test_a_folder_is_built_as_a_whole_or_not_at_all(tmp_path):
    source, out = tmp_path / "src", tmp_path / "bin"
    source.mkdir()
    shutil.copyfile(SRC / "kin.toml", source / "kin.toml")
    shutil.copyfile(SRC / "config.toml", source / "config.toml")
    assert sorted(path.name for path, _ in api.build_files(source, out)) == ["config.tbl", "kin.tbl"]
    (out / "config.tbl").write_bytes(b"of before")
    (source / "space.toml").write_text('kind = "space"\njunk = 1\n')
    with pytest.raises(BadInput, match="junk"):
        api.build_files(source, out)
    assert (out / "config.tbl").read_bytes() == b"of before" and not (out / "space.tbl").exists()


def test_a_space_in_a_folder_is_built_for_the_tables_of_that_folder(tmp_path, monkeypatch):
    source, out, whole = tmp_path / "src", tmp_path / "bin", api.build
    source.mkdir()
    shutil.copyfile(SRC / "kin.toml", source / "kin.toml")
    (source / "space.toml").write_text('kind = "space"\n')
    out.mkdir()
    (out / "kin.tbl").write_bytes(b"of before")
    (out / "arm.tbl").write_bytes(b"as it is")
    seen = {}

    def build(path, folder):
        if path.stem == "space":
            seen.update({image.name: image.read_bytes() for image in folder.glob("*.tbl")})
            raise BadInput("not there", str(folder / "camera.tbl"))
        return whole(path, folder)

    monkeypatch.setattr(api, "build", build)
    with pytest.raises(BadInput) as error:
        api.build_files(source, out)
    assert error.value.where == str(out / "camera.tbl")
    assert seen == {"kin.tbl": (BIN / "kin.tbl").read_bytes(), "arm.tbl": b"as it is"}
    assert (out / "kin.tbl").read_bytes() == b"of before"


def test_commands_say_what_they_built_and_show(tmp_path):
    out = tmp_path / "kin.tbl"
    said = shell("table", "build", SRC / "kin.toml", out).stdout
    crc = codec.header(out.read_bytes()).crc_text
    assert said == f"{out}: kin, {len(out.read_bytes())} bytes, CRC {crc}\n"
    shown = shell("table", "show", out).stdout
    assert crc in shown and "n_poses" in shown


def test_bit_sets_are_bytes_and_an_error_of_a_kind_has_no_place_unless_it_is_given():
    doc = codec.to_doc(codec.decode((BIN / "space.tbl").read_bytes())[1])
    assert [key for key, value in doc.items() if isinstance(value, bytes)] == ["edge"]
    with pytest.raises(BadInput, match="this is a terms table") as error:
        codec.decode_as("kin", (BIN / "terms.tbl").read_bytes())
    assert error.value.where == ""


def test_terms_of_special_frames_are_shown_by_name():
    terms = codec.new("terms")
    for k, name in enumerate(("TOOL", "CAMERA", "MEAS")):
        terms.term[k].frame = FLIGHT.constant(f"KC_FRAME_{name}")
    terms.n_term, terms.n_coef = 3, 1
    assert [t["at"] for t in tables.readable(terms)["term"]] == ["tool", "camera", "meas"]


def test_schemas_for_editors_have_the_limits():
    schema = sources.KinSource.model_json_schema()["properties"]
    assert (schema["arm_crc"]["minimum"], schema["arm_crc"]["maximum"]) == (0, 2**32 - 1)
    assert schema["session"]["minimum"] == 0 and "maximum" not in schema["session"]
    (plain, text) = sources.TagEntry.model_json_schema()["properties"]["size_m"]["anyOf"]
    assert plain == {"type": "number", "exclusiveMinimum": 0.0} and text["type"] == "string"


def test_a_header_has_two_bytes_of_kind_and_version_and_four_of_the_crc():
    head = b"KCT1" + (1).to_bytes(2, "little") + (0x0102).to_bytes(2, "little") + bytes(4)
    image = codec.header(head + (0x01020304).to_bytes(4, "little"))
    assert (image.kind, image.version, image.crc_text) == ("arm", 0x0102, "01020304")
    with pytest.raises(BadInput, match="unknown table kind 257"):
        codec.header(b"KCT1" + b"\1\1" + bytes(10))
