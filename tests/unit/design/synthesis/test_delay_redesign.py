"""WDC with the latency in its design plant, judged with the exact delay on the independent model."""

from __future__ import annotations

import pytest
from independent.two_area import OMEGA_B, linear_plant

from interarea.cosim.study.delay import least_damping
from interarea.design.delay.curves import delay_margin
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.design.synthesis.study_designs import WdcSpec, design_wdc


@pytest.mark.slow
def test_a_design_that_knows_the_latency_keeps_damping_and_margin() -> None:
    relative = remove_reference(linear_plant("two-area-thesis"))
    plant = speeds_in_rad(relative, OMEGA_B)
    without = design_wdc(relative, omega_b=OMEGA_B).system
    knowing = design_wdc(relative, WdcSpec(latency_s=0.2, order=8), omega_b=OMEGA_B).system
    late = {"G2_dw": 0.2, "G4_dw": 0.2}
    assert least_damping(plant, knowing, late) >= 3.0 * least_damping(plant, without, late)
    assert delay_margin(plant, knowing).margin_s >= delay_margin(plant, without).margin_s + 0.2
