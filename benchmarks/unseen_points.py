"""What the shipped robust controllers hold at operating points that no design saw.

Run `python benchmarks/unseen_points.py`; exact latency on the full plants, conditions of the design.
"""

from __future__ import annotations

from interarea.cosim.designs.design_file import load_design
from interarea.cosim.run.artefacts import linear_plant
from interarea.design.controllers.bundled import shipped_controller, shipped_names
from interarea.design.linear.linearise import remove_reference, speeds_in_rad
from interarea.design.robust.operating_points import judge_family
from interarea.fmu_build.write.cache import default_cache
from interarea.models.case.case import load_case
from interarea.models.case.variants import operating_variant

POINTS = {
    "load +5 %": {"load_scale": 1.05},
    "load -10 %": {"load_scale": 0.90},
    "tie +50": {"tie_flow_mw": 50.0},
    "tie -350": {"tie_flow_mw": -350.0},
    "tie -100, 8-9 out": {"tie_flow_mw": -100.0, "out": ["8-9 a"]},
    "7-8 out": {"out": ["7-8 b"]},
    "tie -300, 7-8 out": {"tie_flow_mw": -300.0, "out": ["7-8 a"]},
    "load -5 %, tie +50": {"load_scale": 0.95, "tie_flow_mw": 50.0},
}


def main() -> None:
    """Print one line per shipped controller and operating point."""
    case, cache = load_case("two-area-thesis"), default_cache()
    for name in shipped_names():
        controller, conditions = shipped_controller(name), load_design(name).family()
        for point, change in POINTS.items():
            variant = operating_variant(case, **change)  # type: ignore[arg-type]
            plant = speeds_in_rad(remove_reference(linear_plant(variant, cache)), case.omega_b)
            found = judge_family({point: plant}, controller.system, conditions)
            stable = "all stable" if all(row.stable for row in found.rows) else "UNSTABLE"
            print(
                f"{name:14} {point:20} worst {found.worst_swing:.3f} "
                f"inter-area {found.inter_area:.3f} {stable}"
            )


if __name__ == "__main__":
    main()
