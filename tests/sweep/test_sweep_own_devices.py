"""A case with devices of its own in a sweep: the rows of the package's device, wherever the runs are made."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from interarea.cosim.run.artefacts import sparse_linear_plant
from interarea.cosim.sweep.front import run_sweep
from interarea.cosim.sweep.parts import read_rows
from interarea.cosim.sweep.plan import plan_of_document, plan_sweep
from interarea.cosim.sweep.runner import Runner
from interarea.cosim.sweep.spec import load_sweep
from interarea.models.case.case import load_case
from interarea.models.devices.library import library

PARAMETERS = {
    "gain": {"path": "case.machines.G1.exciter.KA", "values": [150.0, 250.0]},
    "latency": {"path": "channels.remote.latency_s", "values": [0.1, 0.3]},
}


@pytest.fixture
def tables(document: Any, tmp_path: Path) -> dict[str, dict[str, Any]]:
    """Return one sweep twice: with the package's exciter, and with its copy beside the case."""
    (tmp_path / "grid").mkdir()
    text = library()["static"].device.text
    (tmp_path / "grid" / "exciter.toml").write_text(text.replace('name = "static"', 'name = "MINE"'))
    for kind, first in (("static", ""), ("mine", 'devices = ["exciter.toml"]\n')):
        (tmp_path / "grid" / f"{kind}.toml").write_text(
            f'base = "two-area-thesis"\nname = "grid"\n[change]\n{first}[change.machines.defaults]\n'
            f'exciter = {{ kind = "{kind}", KA = 200.0, TA = 0.001, TR = 0.01 }}\n'
        )
    documents = {k: document({"case": str(tmp_path / "grid" / f"{k}.toml")}) for k in ("static", "mine")}
    return {k: table | {"parameters": PARAMETERS} for k, table in documents.items()}


@pytest.mark.slow
def test_rows_are_those_of_the_package_in_one_process_and_in_others(
    tables: dict[str, dict[str, Any]], cache: Path, tmp_path: Path
) -> None:
    run_sweep(tables["static"], tmp_path / "plain", workers=1, cache=cache)
    expected = read_rows(tmp_path / "plain")
    assert set(expected.status) == {"ok"} and expected.damping_inter_area.nunique() == 4
    plan = plan_sweep(load_sweep(tables["mine"]), cache)
    run_sweep(tables["mine"], tmp_path / "apart", workers=2, cache=cache)
    pd.testing.assert_frame_equal(read_rows(tmp_path / "apart"), expected, check_exact=True)
    sparse = [
        sparse_linear_plant(load_case(tmp_path / "grid" / f"{kind}.toml"), cache)
        for kind in ("static", "mine")
    ]
    assert np.array_equal(*(plant.state_matrix() for plant in sparse))
    shutil.rmtree(tmp_path / "grid")  # what a machine elsewhere does not have
    again = plan_of_document(json.loads(json.dumps(plan.document())))
    (tmp_path / "scratch").mkdir()
    with Runner(again, cache, tmp_path / "scratch") as runner:
        rows = sorted((o.row for o in runner.outcomes(range(4))), key=lambda row: row["run"])
        plants = [system.participants["plant"] for system in runner._live.values()]
        if runner.lanes > 1:
            assert all(p.group is not None and p.group is not runner.library for p in plants)
    result = pd.DataFrame(rows)[["run", "damping_inter_area", "peak_pu", "energy_pu2s"]]
    pd.testing.assert_frame_equal(result, expected[list(result)], check_exact=True)
