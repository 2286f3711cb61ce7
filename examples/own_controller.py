"""A new controller dropped into the loop: any linear system whose inputs and outputs are named.

Here: a wash-out and a lead on the difference of the speeds of G2 and G4, acting on G4. Speeds are in
rad/s, the output is in pu and limited to +-0.15 pu by the controller FMU.
"""

import control
import numpy as np

import interarea as ia

s = control.tf("s")
shape = -0.02 * (5 * s / (1 + 5 * s)) * (1 + 0.25 * s) / (1 + 0.05 * s) / (1 + 0.02 * s)
K = control.ss(shape)
controller = control.ss(
    K.A, K.B @ np.array([[1.0, -1.0]]), K.C, np.zeros((1, 2)), inputs=["G2_dw", "G4_dw"], outputs=["G4_vs"]
)

study = {
    "case": "two-area-thesis",
    "stop_s": 20.0,
    "channels": {"remote": {"signal": "G2_dw", "latency_s": 0.05}},  # G4_dw is local and comes undelayed
    "event": [{"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}],
}
without = ia.simulate(study)
with_it = ia.simulate(study, controller=controller)
print(f"inter-area damping {without.damping_ratio():.3f} -> {with_it.damping_ratio():.3f}")
