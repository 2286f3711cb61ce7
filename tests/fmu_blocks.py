"""One block of every kind, for the conformance tests."""

from __future__ import annotations

import numpy as np
from fmu_runner import decay_block

from interarea.fmu_build.write.description_xml import record_entries
from interarea.models.blocks.binary_table import pack_record
from interarea.models.blocks.channel import channel_block
from interarea.models.blocks.concentrator import concentrator_block
from interarea.models.blocks.container import LoopMember, loop_block
from interarea.models.blocks.controller import controller_block
from interarea.models.blocks.detector import detector_block
from interarea.models.blocks.plant import plant_block
from interarea.models.blocks.pmu import pmu_block
from interarea.models.blocks.supervisor import supervisor_block
from interarea.models.blocks.variables import Block
from interarea.models.case.case import load_case

A = np.array([[-1.0, 4.0, 0.0], [-4.0, -1.0, 0.5], [0.0, 0.0, -3.0]])
B = np.array([[0.0, 1.0], [1.0, 0.0], [0.5, -0.5]])
C = np.array([[0.5, 0.0, 1.0]])


def blocks() -> dict[str, Block]:
    """Return one block of every kind."""
    controller = controller_block("controller", A, B, C, np.zeros((1, 2)), ["G2_dw", "G4_dw"], ["G4_vs"])
    plant = plant_block(load_case("two-area-thesis"))
    return {
        "decay": decay_block(),
        "controller": controller,
        "supervisor": supervisor_block(
            "supervisor",
            {
                "both": (A, B, C, np.zeros((1, 2))),
                "off": tuple(np.zeros(s) for s in ((0, 0), (0, 2), (1, 0), (1, 2))),
            },
            ["off", "off", "off", "both"],
            ["G2_dw", "G4_dw"],
            ["G4_vs"],
        ),
        "channel": channel_block(),
        "concentrator": concentrator_block(2),
        "detector": detector_block(["G1_dw", "G2_dw", "G4_dw"]),
        "pmu": pmu_block(),
        "plant": plant,
        "loop": closed_loop(plant, controller),
    }


def closed_loop(plant: Block, controller: Block) -> Block:
    """Return the loop of a plant, a channel for one signal and a controller, as one block."""
    blocks = {"plant": plant, "controller": controller, "remote": channel_block()}
    members = [LoopMember(name, block, pack_record(record_entries(block))) for name, block in blocks.items()]
    wires = [
        ("plant.G2_dw", "remote.u"),
        ("remote.y", "controller.G2_dw"),
        ("plant.G4_dw", "controller.G4_dw"),
        ("controller.G4_vs", "plant.G4_vs"),
    ]
    return loop_block("loop", members, wires, step_s=0.01, stop_s=2.0)
