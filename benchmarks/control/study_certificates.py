"""What WDC, CC and FTC hold over the family of `robust_latency`; writes the certificates beside the designs.

Run `python benchmarks/control/study_certificates.py`; of its operating points the base and the weakest, tie
+100 MW: full plants with exact latency, then every fault of the acceptance (576), clearing times left out.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from interarea.cosim import designs
from interarea.cosim.designs.acceptance import judge_acceptance
from interarea.cosim.designs.certificate_words import first_failures
from interarea.cosim.designs.design_file import certify, load_design
from interarea.cosim.designs.family import family_cases
from interarea.cosim.run.controllers import design_controller
from interarea.cosim.scenario.names import CONTROLLER_NAMES
from interarea.design.controllers.json_text import json_text
from interarea.fmu_build.write.cache import default_cache

POINTS = ("base", "tie +100")


def main() -> None:
    """Write certificate_NAME.json for each and print its first failures."""
    design, cache = load_design("robust_latency"), default_cache()
    points = tuple(point for point in design.point if point.name in POINTS)
    table = design.model_copy(update={"fault": None, "point": points})
    assert table.acceptance is not None
    for name in CONTROLLER_NAMES:
        controller = design_controller(table.grid, name, cache)
        certificate = certify(table, controller, cache)
        acceptance = judge_acceptance(
            controller, family_cases(table), table.acceptance, cache, clearing=False
        )
        document = replace(certificate, acceptance=acceptance.as_dict()).as_dict()
        path = Path(str(designs.__file__)).parent / f"certificate_{name}.json"
        path.write_text(json_text(json.loads(json.dumps(document))), encoding="utf-8")
        print(f"{name}: {first_failures(document)}", flush=True)


if __name__ == "__main__":
    main()
