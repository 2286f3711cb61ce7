"""Strangers' device files: one error class, one line with the place, and nothing foreign in the C."""

from __future__ import annotations

import random
import re
import time
import tomllib

import pytest

from interarea.models.devices.document import ELEMENTS as ELEMENT_WORDS
from interarea.models.devices.document import OPTIONS
from interarea.models.devices.emit import devices_header
from interarea.models.devices.language.device import ELEMENTS
from interarea.models.devices.language.expression import FUNCTIONS
from interarea.models.devices.language.read import device_of
from interarea.models.devices.language.structure import Model
from interarea.models.devices.library import library, own_model
from interarea.models.devices.schema import device_schema
from interarea.models.errors import DeviceError

GOOD = '''name = "MY_AVR"
kind = "exciter"
title = "an example"
diagram = """
v   = lag(vc, TR)                            # transducer
y   = leadlag(vref + vs - v, TC, TB)         # lead-lag
efd = lag(y, TA, K=KA, min=EMIN, max=EMAX)   # field voltage
"""
[dyr]
MYAVR = "TR TC TB KA TA EMIN EMAX"
[parameters]
TR = { unit = "s", min = 0, default = 0.02 }
TC = { unit = "s", min = 0 }
TB = { unit = "s", min = 0 }
KA = { above = 0 }
TA = { unit = "s", min = 0 }
EMIN = { unit = "pu" }
EMAX = { unit = "pu" }
[check]
"EMIN <= EMAX" = "swap them"
'''


def test_the_example_is_a_device():
    device = device_of(GOOD, "my_avr.toml")
    assert [line.name for line in device.lines] == ["v", "y", "efd"]
    assert device.by_name["TR"].default == 0.02


WRONG = [
    ("leadlag(", "ledlag(", r"my_avr.toml:6: ledlag\(\): no such function, did you mean leadlag"),
    ("vref + vs - v", "vref + lag(v, TR)", r"my_avr.toml:6: lag has a state and needs a line of its own"),
    ('"s", min = 0 }\nTB', '"sec", min = 0 }\nTB', r"my_avr.toml:13: TC.unit = 'sec', allowed: 1, s, pu"),
    ("y   =", "in  =", r"my_avr.toml:6: in is a reserved word; use another name, such as in_"),
    ("lag(y,", "lag(v,", r"my_avr.toml:6: the signal y is not used"),
    ("TR = {", "TZ = { unit = '1' }\nTR = {", r"my_avr.toml:12: TZ is not used"),
    ("y   =", "v   =", r"my_avr.toml:5: v is defined twice"),
    ("- v,", "- w,", r"my_avr.toml:6: w is not known,"),
    ("TC TB KA", "TC TQ KA", r"my_avr.toml:10: dyr.MYAVR: TQ is no parameter, did you mean"),
    ("min=EMIN", "mini=EMIN", r"my_avr.toml:7: lag\(\) has no option mini, did you mean min"),
    ("lag(vc, TR)", "lag(vc, vt)", r"my_avr.toml:5: lag\(\): vt holds the signal vt, allowed: parameters"),
    (
        "vref + vs",
        "vref + (vs > v)",
        r"my_avr.toml:6: vs > v: a comparison, allowed: as the condition of pick",
    ),
    ("vref + vs", "vref + vs.real", r"my_avr.toml:6: attribute in an expression is not allowed"),
    ("vref + vs", "__import__('os')", r"my_avr.toml:6: __import__\(\): no such function"),
    ("vref + vs", "vref**9 + vs", r"my_avr.toml:6: the power 9, allowed: 2, 3, 4"),
    ('kind = "exciter"', 'kind = "exiter"', r"my_avr.toml:2: kind = 'exiter', did you mean exciter"),
    ("title", "titel", r"my_avr.toml:3: titel: no such key here, did you mean title"),
    ("efd = lag", "eft = lag", r"my_avr.toml: no line gives efd, the output of a exciter"),
    ("default = 0.02", "default = -1", r"my_avr.toml:12: TR.default = -1 is outside its own range"),
    (
        "min = 0, default = 0.02",
        "min = 2, max = 1",
        r"my_avr.toml:12: TR: min = 2, max = 1, allowed: a range",
    ),
    ('"EMIN <= EMAX"', '"EMIN <= EMEX"', r"my_avr.toml:20: EMEX is not known in \[check\]"),
    ("transducer", "\u00b5" * 300000, r"longer than 65536 bytes"),
]


@pytest.mark.parametrize(("old", "new", "says"), WRONG)
def test_what_is_wrong_is_said_with_its_line_and_remedy(old, new, says):
    assert old in GOOD
    with pytest.raises(DeviceError, match=says) as caught:
        device_of(GOOD.replace(old, new, 1), "my_avr.toml")
    assert "\n" not in str(caught.value)


def test_every_element_and_function_has_its_words():
    said = {call.partition("(")[0] for call in ELEMENT_WORDS}
    assert said == {*FUNCTIONS, *ELEMENTS, "ramp"}
    options = {word.split("=")[0] for words in OPTIONS for word in words.split(", ")}
    assert options == {option for _, known in ELEMENTS.values() for option in known}


def test_every_device_of_the_package_fits_the_schema_of_device_files():
    schema = device_schema()
    for model in library().values():
        raw = tomllib.loads(model.device.text)
        assert set(schema["required"]) <= set(raw) <= set(schema["properties"]), model.device.name
        for row in raw.get("parameters", {}).values():
            assert set(row) <= set(schema["$defs"]["Parameter"]["properties"])
            assert row.get("unit", "1") in schema["$defs"]["Parameter"]["properties"]["unit"]["enum"]


def test_a_library_name_is_taken():
    with pytest.raises(DeviceError, match="'sexs' is a device of the package; choose another name"):
        own_model(GOOD.replace("MY_AVR", "sexs"), "my_avr.toml")


def test_a_loop_without_a_state_is_refused_where_a_time_is_zero():
    text = GOOD.replace("vref + vs - v", "vref + vs - v - efd")
    model = Model(device_of(text, "my_avr.toml"))
    values = {
        "TR": 0.0,
        "TC": 1.0,
        "TB": 2.0,
        "KA": 9.0,
        "EMIN": -1.0,
        "EMAX": 1.0,
        "MBASE": 1.0,
        "vref": 1.0,
    }
    assert model.order_of(model.has(values | {"TA": 0.1}))[-1] == "y"
    with pytest.raises(DeviceError, match=r"the signals (y <- efd <- y|efd <- y <- efd) form a loop"):
        model.order_of(model.has(values | {"TA": 0.0}))


def test_a_device_of_more_than_128_decisions_is_refused():
    """The lag has four, each abs() one: they are bits of two words."""

    def deciding(most: int) -> Model:
        each = [f"abs(vc - {k / 100})" for k in range(most - 4)]
        parts = [each[k : k + 10] for k in range(0, len(each), 10)]
        rows = [f"a{k} = {' + '.join(part)}" for k, part in enumerate(parts)]
        total = " + ".join(f"a{k}" for k in range(len(parts)))
        rows.append(f"efd = lag(y - ({total}), TA")
        return Model(device_of(GOOD.replace("efd = lag(y, TA", "\n".join(rows), 1), "my_avr.toml"))

    assert "limiter_state(&l, 60u," in devices_header([deciding(64)])  # and 61 to 63
    assert "limiter_state(&l2, 60u," in devices_header([deciding(128)])
    assert "limiter_state(&l2, 0u," in devices_header([deciding(66)])  # four stand in one word
    with pytest.raises(DeviceError, match=r"MY_AVR: .* make 132 decisions, allowed: 128 in one device; give"):
        devices_header([deciding(129)])


def mutant(text: str, rng: random.Random) -> str:
    for _ in range(rng.randint(1, 4)):
        at, to = sorted((rng.randrange(len(text) + 1), rng.randrange(len(text) + 1)))
        to = min(to, at + rng.choice((1, 1, 3, 20, 200)))
        piece = text[at:to]
        other = rng.randrange(len(text))
        text = rng.choice(
            (
                text[:at] + text[to:],
                text[:at] + piece + piece + text[to:],
                text[:at] + text[other : other + len(piece)] + text[to:],
                text[:at] + rng.choice(WORDS) + text[to:],
                text[:at] + chr(rng.choice((0, 9, 34, 39, 42, 47, 92, 233, 955, 8232, 0x1F600))) + text[at:],
            )
        )
    return text


WORDS = (
    "lag(", ")", "*/", "/*", "**", "1e999", "-", "((((((((", "K=", "nan", "inf", "'''", '"', "\\u0000", "[",
    "efd", "vref", "#include <stdio.h>", "; system(x);", "pick(", "table(", "vx(", "9" * 400, "\r\n", "=",
    "\u00e9", "ramp(v, TR, TC, 2, 1)", "pi(v, 1, 2)", "filter2(v, 1, 2, 3, 4)", "MBASE", "ROWS", "int",
)  # fmt: skip
C_LETTERS = re.compile(r"[A-Za-z0-9_ \n\t(){}\[\];,.:*/+=<>!&|?#\"-]*")


def survive(count: int, seed: int) -> tuple[int, float]:
    """Mutate files of the package and the example; return how many are devices, and the longest time."""
    rng = random.Random(seed)
    texts = [GOOD, *(model.device.text for model in library().values())]
    good, longest = 0, 0.0
    for _ in range(count):
        text = mutant(rng.choice(texts), rng)
        start = time.process_time()
        try:
            header = devices_header([Model(device_of(text, "mutant.toml"))])
        except DeviceError as error:
            assert "\n" not in str(error)
            assert len(str(error)) < 1000
        else:
            good += 1
            assert C_LETTERS.fullmatch(header), text
            assert header.count("/*") == header.count("*/")
        longest = max(longest, time.process_time() - start)
    return good, longest


@pytest.mark.slow
def test_mutated_files_end_in_one_error_class_or_clean_c():
    good, longest = survive(600, 1)
    assert good > 20
    assert longest < 0.5


@pytest.mark.slow
def test_twenty_thousand_mutated_files():
    good, longest = survive(20000, 2)
    assert good > 1000
    assert longest < 2.0  # about 0.1 s on an idle core; collecting the garbage of other tests takes .5 s
