"""Lines that only absent parts of a device use are not computed; which ones is told by another path here."""

import numpy as np
import pytest
from test_device_library import SEEN, TYPICAL, Driver, at_rest, complete

from interarea.models.devices.language.element import names_passed, resolved
from interarea.models.devices.language.need import needs_of
from interarea.models.devices.library import library
from interarea.models.devices.rest import rest_of

PLANT = ("rv", "rq", "re", "rc", "rlow", "rpi", "rp", "rfr", "rfi", "rdf", "rdp", "rpe", "rpp")
TURBINE = ("wblade", "pet", "wref", "terr", "torqi", "torque", "werr", "pitwi", "pitci", "pitin", "pitch")
LOOP = ("theta", "cpll", "spll", "vld", "vlq", "wpll", "cdl", "sdl", "ide", "iqe", "ipu", "iqu", "e", "delta")


def needed(model, has):
    """Every line that outputs and rates of the structure `has` reach."""
    on, elements = model.on_of(has), model.elements
    open_names = {*model.device.outputs}
    for element in elements.values():
        if any(on(state.present) for state in element.states()):
            nodes = (*element.args, *(node for _, node in element.line.node.options))
            open_names |= {
                element.line.name,
                *(n for u in nodes for n in resolved(model.device, u, on).names),
            }
    reached = set()
    while open_names:
        name = open_names.pop()
        if name in elements and name not in reached:
            reached.add(name)
            open_names |= names_passed(elements[name], on)
    return reached


def order_at(model, has):
    """The lines in their order for the structure `has`, and what was decided on the way there."""
    order, decided = model.order, {}
    while order.bit is not None:
        decided[order.bit] = bool(has >> order.bit & 1)
        order = order.yes if decided[order.bit] else order.no
    return order.lines, decided


@pytest.mark.parametrize("name", library())
def test_what_a_structure_reaches_is_computed(name):
    """For any bits, such as no parameters give."""
    model, rng = library()[name], np.random.default_rng(3)
    for _ in range(60):
        has = sum(1 << k for k in model.bits.values() if rng.random() < rng.choice([0.2, 0.5, 0.8]))
        lines, decided = order_at(model, has)
        if lines:
            needs = needs_of(model, lines, model.on(decided))
            assert needed(model, has) <= {line for line in lines if needs[line].holds(has)}


def test_a_plain_converter_computes_no_plant_control_turbine_or_loop():
    model = library()["wecc_converter"]
    has = model.has(complete(model, {}))
    lines, decided = order_at(model, has)
    needs = needs_of(model, lines, model.on(decided))
    assert not [line for line in (*PLANT, *TURBINE, *LOOP) if needs[line].holds(has)]


@pytest.mark.parametrize(("plant", "switches"), [(0.0, 0), (1.0, 1)])
def test_an_absent_plant_control_switches_nothing(plant, switches, tmp_path):
    """Its error of reactive power passes plant_emax; without it that is no reason to do a step again."""
    model, values = TYPICAL["REGCA1"]
    _, inputs = at_rest("REGCA1")
    values = complete(model, values | {"PLANT": plant, "plant_Ki": 5.0 * plant, "plant_Qmax": 9.0})
    point = rest_of(model, values, inputs, 0.4, "plain")
    driver = Driver([model], tmp_path)
    for mode, moved in (("note", 0.0), ("watch", 0.3)):
        seen = SEEN | inputs | {"qbr": inputs["qbr"] + moved}
        driver.run(model, [point.instance], [point.states], [seen], 0, mode)
    assert driver.measured == switches
