"""A system put together in Python: plant, controller, a channel with an outage, a pulse."""

import interarea as ia

grid = ia.System(stop_s=20.0)
grid.plant("two-area-thesis")
grid.controller("wdc")
grid.channel("remote", latency_s=0.1, outages_s=[(10.0, 12.0)])
grid.connect("plant.G2_dw", "remote", "controller.G2_dw")
grid.connect("plant.G4_dw", "controller.G4_dw")
grid.connect("controller.G4_vs", "plant.G4_vs")
grid.event("vref_pulse", machine="G1", size_pu=0.05, start_s=1.0, end_s=1.2)
result = grid.run()

print(result.explain())
print(result.data[["time_s", "plant.G2_dw", "remote.y", "remote.valid"]].iloc[::250])
print(f"units: {result.units['plant.G2_dw']}, {result.units['plant.G2_delta']}")
