"""A user's own devices in a case: the library's bits, a closed form, records, files, and what is wrong."""

from __future__ import annotations

import pickle
import time
from pathlib import Path

import numpy as np
import pytest
from grid_text import dyr_text, raw_text
from plant_shim import BlockFailure, BlockShim

from interarea.cosim.explorer.wasm import container_wasm
from interarea.fmu_build.errors import NoCompilerError
from interarea.fmu_build.write import compile as compiling
from interarea.fmu_build.write.package import build_fmu
from interarea.formats import TEMPLATES
from interarea.models.blocks.plant import plant_block
from interarea.models.case.case import Case, CaseError, load_case
from interarea.models.case.write_toml import export_toml
from interarea.models.devices.library import library, own_models
from interarea.models.exporters.dyr import dyr_of
from interarea.models.exporters.raw import raw_of
from interarea.models.importers.imported import ImportOptions
from interarea.models.importers.psse import import_psse

AVR = (TEMPLATES / "device.toml").read_text(encoding="utf-8")
PI = """name = "MY_PI"
kind = "exciter"
diagram = '''
v   = lag(vc, TR)
u   = pi(vref + vs - v, KP, KI, min=-9, max=9)
efd = lag(u, TA, min=-6, max=6)
'''
[parameters]
TR = { unit = "s", min = 0 }
KP = { above = 0 }
KI = { above = 0 }
TA = { unit = "s", above = 0 }
"""
PI_ROW = {"kind": "my_pi", "TR": 0.02, "KP": 20.0, "KI": 5.0, "TA": 0.05}


def copied(case: Case) -> Case:
    """Return `case` with the exciters and governors of its machines under other names."""
    rows, texts = {}, {}
    for m in case.machines:
        rows[m.name] = {}
        for word in ("exciter", "governor"):
            control, name = getattr(m, word), f"Copied_{word}"
            device = library()[control.kind].device
            texts[f"{name}.toml"] = device.text.replace(f'name = "{device.name}"', f'name = "{name}"')
            rows[m.name][word] = {"kind": name.lower(), **control.parameters}
    return case.with_changes({"devices": texts, "machines": rows})


@pytest.mark.slow
def test_a_renamed_copy_gives_the_bits_of_the_library() -> None:
    """Jacobians, and rates with every limiter reached."""
    case = load_case("two-area-thesis")
    one, two = BlockShim(plant_block(case)), BlockShim(plant_block(copied(case)))
    assert one.state_names == two.state_names
    for ours, theirs in zip(one.jacobians(), two.jacobians(), strict=True):
        assert np.array_equal(ours, theirs)
    rng = np.random.default_rng(4)
    for _ in range(50):
        x = one.x * rng.uniform(0.2, 3.0, len(one.x)) + rng.normal(0.0, 0.3, len(one.x))
        for ours, theirs in zip(one.derivatives(x), two.derivatives(x), strict=True):
            assert np.array_equal(ours, theirs)


@pytest.mark.slow
def test_a_new_device_has_its_transfer_function(tmp_path: Path) -> None:
    """From G1_vs to the field voltage with the terminal voltage held: (KP + KI/s)/(1 + s TA)."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "pi.toml").write_text(PI)
    row = ", ".join(f"{k} = {v!r}" for k, v in PI_ROW.items()).replace("'", '"')
    (tmp_path / "grid.toml").write_text(
        'base = "kundur-manual"\nname = "grid"\n[change]\ndevices = ["mine/pi.toml"]\n'
        f"[change.machines.defaults]\nexciter = {{ {row} }}\n"
    )
    case = load_case(tmp_path / "grid.toml")
    plant = BlockShim(plant_block(case))
    own = [k for k, name in enumerate(plant.state_names) if name.startswith("G1.exciter.")]
    assert len(own) == 3
    A, B, _, _ = plant.jacobians()
    field = plant.state_names.index("G1.eq1")
    b = B[:, plant.input_names.index("G1_vs")]
    Td01 = case.machine("G1").number("Td01")
    for f in (0.01, 0.3, 1.0, 20.0):
        s = 2j * np.pi * f
        inner = np.linalg.solve(s * np.eye(3) - A[np.ix_(own, own)], b[own])
        result = Td01 * (A[field, own] @ inner + b[field])
        expected = (PI_ROW["KP"] + PI_ROW["KI"] / s) / (1.0 + s * PI_ROW["TA"])
        assert result == pytest.approx(expected, rel=1e-9)


def avr_case() -> Case:
    row = {"exciter": {"kind": "my_avr", "KA": 150.0, "TB": 0.0}}
    return load_case("kundur-manual").with_changes(
        {"devices": {"a.toml": AVR}, "machines": {"defaults": row}}
    )


def test_a_case_carries_its_devices_and_its_hash_knows_them(tmp_path: Path) -> None:
    case = avr_case()
    export_toml(case, tmp_path / "x.toml")
    copy = load_case(tmp_path / "x.toml")
    assert copy.devices == case.devices and copy.hash == case.hash
    assert pickle.loads(pickle.dumps(case)).own_devices.keys() == {"my_avr"}
    hard = AVR.replace('min = 0, default = 0.02, text = "amplifier"', "min = 0, default = 0.03")
    assert case.with_changes({"devices": {"a.toml": hard}}).hash != case.hash
    quoted = 'title = "a \\"b\\" \\\\ c"  # """ \\ \x20"'
    odd = AVR.replace('title = "exciter with transient gain reduction"', quoted)
    changed = case.with_changes({"devices": {"a.toml": odd}})
    export_toml(changed, tmp_path / "odd.toml")
    assert load_case(tmp_path / "odd.toml").devices == {"a.toml": odd}


def test_the_record_and_the_sources_of_its_fmu_are_those_of_its_devices() -> None:
    plain, own = plant_block(load_case("kundur-manual")), plant_block(avr_case())
    assert plain.data["device.signature"] != own.data["device.signature"]
    text = own.sources[[p.name for p in own.sources].index("devices.h")].read_text()
    assert "equations_of_my_avr(" in text and "case DEVICE_NUMBER_MY_AVR:" in text
    assert "case DEVICE_NUMBER_SEXS:" not in text  # what no machine has is not compiled
    assert "MY_AVR" in own.documentation["Controls"]
    with pytest.raises(BlockFailure, match="record: "):
        BlockShim(own.__class__(**{**vars(own), "sources": plain.sources}))


USRMDL = "1 'USRMDL' '1' 'MYAVR' 4 0 0 7 3 0 0.02 1.0 0.0\n 150.0 0.02 -5 5 /\n"


@pytest.mark.parametrize("record", [USRMDL, "1 'MYAVR' 1 0.02 1.0 0.0 150.0 0.02 -5 5 /\n"])
def test_a_record_of_its_name_is_the_device_and_goes_out_again(tmp_path: Path, record: str) -> None:
    case = load_case("kundur-manual")
    raw, dyr, file = tmp_path / "a.raw", tmp_path / "a.dyr", tmp_path / "avr.toml"
    raw.write_text(raw_text(case))
    dyr.write_text(dyr_text(case) + record)
    file.write_text(AVR)
    imported = import_psse(raw, dyr, options=ImportOptions(devices=[file])).case
    with_avr = next(m for m in imported.machines if m.bus == 1).exciter
    values = {"TR": 0.02, "TC": 1.0, "TB": 0.0, "KA": 150.0, "TA": 0.02, "EMIN": -5.0, "EMAX": 5.0}
    assert with_avr.kind == "my_avr" and with_avr.parameters == values
    raw.write_text(raw_of(imported).text)
    out = dyr_of(imported).text
    assert "'USRMDL' '1' 'MYAVR' 4 0 0 7 3 0 " in out
    dyr.write_text(out)
    again = import_psse(raw, dyr, options=ImportOptions(devices=[file])).case
    assert [m.exciter for m in again.machines] == [
        m.exciter.model_copy(update={"source": n.exciter.source})
        for m, n in zip(imported.machines, again.machines, strict=True)
    ]


def test_without_a_table_of_records_fields_are_the_parameters_in_order(tmp_path: Path) -> None:
    case = load_case("kundur-manual")
    raw, dyr, file = tmp_path / "a.raw", tmp_path / "a.dyr", tmp_path / "pi.toml"
    raw.write_text(raw_text(case))
    dyr.write_text(dyr_text(case) + "1 'USRMDL' 1 'MY_PI' 4 0 0 4 3 0 0.02 20.0 5.0 0.05 /\n")
    file.write_text(PI)
    imported = next(
        m for m in import_psse(raw, dyr, options=ImportOptions(devices=[file])).case.machines if m.bus == 1
    )
    assert imported.exciter.parameters == {k: v for k, v in PI_ROW.items() if k != "kind"}
    with pytest.raises(
        CaseError, match=r"model 'MY_PI' .*define it as a device named MY_PI and give its file"
    ):
        import_psse(raw, dyr)
    dyr.write_text(dyr_text(case) + "1 'USRMDL' 1 'MY_PI' 4 0 0 3 3 0 0.02 20.0 5.0 /\n")
    with pytest.raises(CaseError, match=r"a.dyr:\d+: MY_PI has 3 fields, allowed: 4, TR KP KI TA"):
        import_psse(raw, dyr, options=ImportOptions(devices=[file]))


def test_a_file_whose_orders_double_with_each_line_is_refused_at_once() -> None:
    """Each pair of lags that may both be absent has two orders; thirteen pairs would be 8192 times the C."""
    pairs = range(13)
    lines = "\n".join(f"a{k} = lag(b{k} + vc, S{k})\nb{k} = lag(a{k}/2 + vref, T{k})" for k in pairs)
    rows = "\n".join(f"S{k} = {{ min = 0 }}\nT{k} = {{ min = 0 }}" for k in pairs)
    total = " + ".join(f"a{k}" for k in pairs)
    text = (
        f'name = "B"\nkind = "exciter"\ndiagram = """\n{lines}\nefd = {total} + vs\n"""\n[parameters]\n{rows}'
    )
    begun = time.process_time()
    with pytest.raises(CaseError, match=r"b\.toml: more than 64 evaluation orders"):
        own_models({"b.toml": text})
    assert time.process_time() - begun < 2.0


def test_lines_of_parameters_that_multiply_are_refused_before_they_are_put_in() -> None:
    product = "*".join(["c2"] * 40)
    many = "\n".join(f"x{k} = vc*({product})" for k in range(60))
    lines = f"c0 = P + 1\nc1 = {' + '.join(['c0'] * 40)}\nc2 = {' + '.join(['c1'] * 12)}\n{many}"
    head = f'name = "B"\nkind = "exciter"\ndiagram = """\n{lines}\nefd = x0 + vs\n"""\n'
    begun = time.process_time()
    with pytest.raises(CaseError, match=r"b\.toml:7: x0 has \d+ parts with parameter lines substituted"):
        own_models({"b.toml": f"{head}[parameters]\nP = {{}}"})
    assert time.process_time() - begun < 1.0


OTHER = AVR.replace("MY_AVR", "OTHER")
WRONG = [
    ('["no.toml"]', {}, r"devices: .*no.toml: no such file, wanted: the TOML file of a device"),
    ('["avr.txt"]', {}, r"devices: 'avr.txt', allowed: the name of a .toml file"),
    ("[3]", {}, r"devices: '3', allowed: the name of a .toml file"),
    ("3", {}, r"devices = '3', allowed: a list of device files"),
    ('["avr.toml"]', {"avr.toml": AVR.replace("leadlag(", "ledlag(")}, r"devices: avr.toml:\d+: ledlag\(\)"),
    ('["avr.toml"]', {"avr.toml": AVR.replace("MY_AVR", "SEXS")}, r"'SEXS' is a device of the package"),
    ('["avr.toml", "b.toml"]', {"avr.toml": AVR, "b.toml": AVR}, r"'MY_AVR' is that of avr.toml too"),
    ('["avr.toml"]', {"avr.toml": AVR.replace("MY_AVR", "A__B")}, r"avr.toml:5: name = 'A__B', allowed"),
    ('["avr.toml"]', {"avr.toml": OTHER}, r"machines.G1.exciter.*'my_avr' does not exist; .*other"),
    (
        '["avr.toml"]',
        {"avr.toml": AVR.replace("above = 0", "above = 400")},
        r"KA = 150.0, allowed: above 400",
    ),
    ('["."]', {}, r"devices: '.', allowed"),
    ('["f.toml"]', {"f.toml/x": ""}, r"f.toml: is a folder, wanted: the TOML file of a device"),
]


@pytest.mark.parametrize(("devices", "files", "says"), WRONG, ids=[w[2][:30] for w in WRONG])
def test_what_is_wrong_is_one_line(tmp_path: Path, devices: str, files: dict[str, str], says: str) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "grid.toml").write_text(
        f'base = "kundur-manual"\nname = "grid"\n[change]\ndevices = {devices}\n'
        '[change.machines.defaults]\nexciter = { kind = "my_avr", KA = 150.0 }\n'
    )
    with pytest.raises(CaseError, match=says) as caught:
        load_case(tmp_path / "grid.toml")
    assert all("grid.toml" in line and "\n" not in line for line in caught.value.args)  # one a machine


def test_without_a_compiler_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(_: str) -> None:
        raise NoCompilerError("pip install 'interarea[build]'")

    monkeypatch.setattr(compiling, "_compiler_of", none)
    for make in (
        lambda: build_fmu(plant_block(avr_case()), tmp_path),
        lambda: container_wasm(case=avr_case()),
    ):
        with pytest.raises(NoCompilerError, match=r"pip install 'interarea\[build\]'"):
            make()
