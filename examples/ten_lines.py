"""The same loop through the Python API."""

import interarea as ia

pulse = {"kind": "vref_pulse", "machine": "G1", "size_pu": 0.05, "start_s": 1.0, "end_s": 1.2}
late = {name: {"signal": s, "latency_s": 0.1} for name, s in {"remote": "G2_dw", "local": "G4_dw"}.items()}
study = {"case": "two-area-thesis", "stop_s": 20.0, "event": [pulse], "channels": late}

run = ia.simulate(study)
print(run.explain())
print(f"inter-area damping {run.damping_ratio('inter-area'):.3f}, peak {run.metrics.peak_pu:.2e} pu")
print(run.data[["time_s", "plant.G2_dw", "remote.y"]].iloc[100:400:50])
