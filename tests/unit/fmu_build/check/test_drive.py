"""The calls with which the check drives a binary are those that the standard allows."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import pytest
from lxml import etree

from interarea.fmu_build.check.runs import Drive
from interarea.fmu_build.open.description import ScalarVariable, read_description

DESCRIPTION = """<fmiModelDescription fmiVersion="2.0" modelName="Feedthrough" guid="1">
<ModelExchange modelIdentifier="Feedthrough"/><CoSimulation modelIdentifier="Feedthrough"/>
<ModelVariables>
<ScalarVariable name="held" valueReference="1" causality="input" variability="discrete"><Real start="0"/>
</ScalarVariable>
<ScalarVariable name="moving" valueReference="2" causality="input"><Real start="0"/></ScalarVariable>
</ModelVariables><ModelStructure/></fmiModelDescription>"""


@dataclass
class Recorder:
    """An instance that writes down in which mode it was called; the mode is that of FMI2, figure 6."""

    interface: str
    mode: str = "continuous"
    sets: list[tuple[str, str]] = field(default_factory=list)

    @property
    def library(self) -> Recorder:
        return self

    def do(self, name: str, *_: Any) -> None:
        self.mode = "event" if name == "EnterEventMode" else self.mode

    def to_continuous(self) -> None:
        self.mode = "continuous"

    def set(self, v: ScalarVariable, _: float) -> int:
        self.sets.append((v.name, self.mode))
        return 0

    def step(self, *_: float) -> None:
        assert self.mode == "continuous"

    def get(self, variables: list[ScalarVariable]) -> list[float]:
        return [0.0 for _ in variables]


@pytest.mark.parametrize(("interface", "mode"), [("ModelExchange", "event"), ("CoSimulation", "continuous")])
def test_discrete_inputs_are_set_in_event_mode_only(interface: str, mode: str) -> None:
    """Else a binary that is right refuses the call, and reset, replay and two instances are found wrong."""
    instance: Any = Recorder(interface)
    Drive(read_description(etree.fromstring(DESCRIPTION))).run(instance, 0, 2)
    assert sorted(set(instance.sets)) == [("held", mode), ("moving", "continuous")]
    assert len(instance.sets) == 4 and instance.mode == "continuous"
