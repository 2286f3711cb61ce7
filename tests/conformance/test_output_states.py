"""Outputs that are states: their slopes are read off the derivatives, to the bit as by the complex step."""

from __future__ import annotations

from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmu_runner import Runner

from interarea.cosim.master.instances import FmuParticipant
from interarea.cosim.run.artefacts import plant_fmu
from interarea.fmu_build.open.fmu_file import FmuFile
from interarea.models.blocks.binary_table import pack_record, unpack_record
from interarea.models.case.case import load_case


@pytest.mark.parametrize("case", ["two-area-thesis", "new-england"])
def test_slopes_of_states_are_those_of_the_complex_step(case: str, cache: Path) -> None:
    file = FmuFile(plant_fmu(load_case(case), cache))
    outputs = [p.name for p in file.description.outputs]
    speeds = tuple(name for name in outputs if name.endswith("_dw"))
    state = next(name for name in file.variables if name.endswith(".slip"))
    result = []
    for requested in (speeds, (*speeds, "tie_p" if "tie_p" in outputs else outputs[2])):
        plant = FmuParticipant("plant", file, {state: 1e-3})
        plant.bind([], requested)  # the second asks for a slope that only the complex step gives
        plant.begin(0.0, 1.0)
        plant.ready()
        rows = []
        for k in range(20):
            plant.advance(0.01 * k, 0.01)
            plant.receive(slopes=True)
            rows.append(list(plant.dy)[: len(speeds)])
        result.append(np.array(rows))
        plant.close()
    assert np.abs(result[0]).max() > 1e-4
    assert result[0].tobytes() == result[1].tobytes()


def test_a_record_that_points_outside_the_states_is_refused(cache: Path, tmp_path: Path) -> None:
    fmu = plant_fmu(load_case("two-area-thesis"), cache)
    fmpy.extract(str(fmu), str(tmp_path))
    file = tmp_path / "resources" / "model.bin"
    arrays = unpack_record(file.read_bytes())
    sound = np.array(arrays["output.state"])
    for wrong in (np.where(sound >= 0, 10_000, sound), sound[:-1]):
        file.write_bytes(pack_record(arrays | {"output.state": wrong.astype(np.int32)}))
        run = Runner.__new__(Runner)
        with pytest.raises(Exception, match="instantiate"):
            Runner.__init__(run, fmu, folder=str(tmp_path))
        assert "`output.state`" in run.log[0]
