"""Where the modules of 0.1 are since 0.2: the error of an old import names the new place."""

from __future__ import annotations

from typing import NoReturn

#: "old folder -> new folder: module ..."; a module with another name stands as old:new.
_TABLE = """
models -> models.case: case case_schema:schema case_schema_controls:control_schema
    case_checks:checks case_parameter:parameter_path case_variants:variants events export_toml:write_toml
models -> models: case_errors:errors toml_kind:documents
models -> models.grid: network powerflow equilibrium plant_ports:bus_devices plant_tables:machine_tables
    plant_controls:control_tables
models -> models.blocks: variables record:binary_table plant_block:plant plant_protocol:linear_plant
    channel_block:channel channel_packets:packet_schedule controller_block:controller
    supervisor_block:supervisor concentrator_block:concentrator loop_block:container
models -> models.importers: import_matpower:matpower import_psse:psse import_psse_branches:static
    import_psse_dyr:dyr
models -> models.importers.raw: import_psse_records:record
fmu_build -> fmu_build.write: compile render:description_xml package documentation
    group:lane_library batch:lane_library
fmu_build -> fmu_build.open: check_description:description check_ssp_units:units open:plant
    check_fmi2:fmi2 cross_check
    check_archive:archive check_xml:xml check_images:images
fmu_build -> fmu_build: check_finding:finding
fmu_build -> fmu_build.check: check check_binary:binary check_delegated:delegated
    check_load:load check_probe:probe
    check_runs:runs check_semantics:semantics check_sensitivity:sensitivity
    check_ssp:ssp
design -> design.linear: linearise norms
design -> design.modes: modes loops:loop_selection sensitivity
design -> design.reduction: reduction:balanced balancing:gramians reduction_hankel:hankel
    reduction_weighted:weighted
design -> design.delay: delay:curves delay_roots:characteristic_roots delay_crossing:margin
    loss:packet_loss conditions:signal_conditions
design -> design.lmi: lmi:expressions problem regions solve recover clarabel_engine
design -> design.lmi.interior_point: interior_point:engine interior_point_iteration:iteration
    interior_point_map:operators interior_point_normal:normal_equations interior_point_scaling:scaling
    interior_point_schur:schur
design -> design.synthesis: synthesis:hinf synthesis_form:lmi_form synthesis_check:check
    synthesis_ftc:fault_tolerant generalized:generalized_plant study_designs
design -> design.robust: robust:design robust_check:spec smoothed:smoothed_objective
    family:operating_points
design -> design.certificates: certificate:closed_loop switching active:bank_design
design -> design.controllers: controller bank shipped:bundled
cosim -> cosim: interpolation:polynomials
cosim -> cosim.master: master stepping wiring:stepping node signals graph timing:step_choice
    initialise:algebraic_loop loops:algebraic_loop secant:algebraic_loop saved:records together:lockstep
    worker:isolated instances
cosim -> fmu_build.open: fmu_file
cosim -> cosim.master.kernel: kernel kernel_build:build
cosim -> cosim.scenario: scenario channels concentrators
cosim -> cosim.results: result ledger:delay_ledger self_test:latency_test metrics pencil:matrix_pencil
    ringdown
cosim -> cosim.results: run_files:run_figure
cosim -> cosim.run: build:system run artefacts controller_file:controller_fmu
cosim -> cosim.export: members:instances ssp container
cosim -> cosim.designs: robust_design:design_file design_comparison:comparison bank_certificate
    sensitivities synchronism:first_swing
cosim -> cosim.sweep: sweep_spec:spec sweep_values:values sweep_point:point sweep_plan:plan
    sweep_prepare:prepare sweep_run:runner sweep_forks:shared_start sweep_group:lane_batches
    sweep_live:live_instances sweep_rows:rows sweep_store:store sweep_search:values sweep_engine:front
cosim -> cosim.sweep.workers: sweep_local:pool sweep_worker:worker
    sweep_cluster:dask_cluster heap:malloc_tuning
cosim -> cosim.maps: maps:page maps_data:page_data maps_figures:page_figures
cosim -> cosim.plots: plots:curves compass:mode_shapes diagrams
cosim -> cosim.study: study study_delay:delay study_figures:figures study_loss:packet_loss study_rows:rows
    study_runs:runs report
cosim -> cosim.study: claims:verdicts published:printed
cosim -> cli: cli:app cli_check:export cli_design:design cli_import:grids cli_list:listing cli_modes:modes
    cli_run:run cli_ssp:export cli_sweep:sweep terminal destination
cosim -> : pytest_plugin
"""


def moved() -> dict[str, str]:
    """Return old name -> new name, both without `interarea.`.

    >>> moved()["cosim.build"]
    'cosim.run.system'
    """
    new_of: dict[str, str] = {}
    for line in _TABLE.strip().replace("\n    ", " ").splitlines():
        places, _, modules = line.partition(":")
        old, new = (place.strip() for place in places.split("->"))
        for module in modules.split():
            before, _, after = module.partition(":")
            new_of[f"{old}.{before}"] = f"{new}.{after or before}".lstrip(".")
    return new_of


def explain(name: str) -> None:
    """Raise ModuleNotFoundError with the new place of `name` if it is one of 0.1; else do nothing.

    A folder may have the name of an old module: there `name` ends with what is looked for in it.
    """
    new_of = moved()
    short = name.partition(".")[2]
    parent, _, thing = short.rpartition(".")
    if short in new_of:
        _tell(short, new_of[short])
    # `from interarea.design.modes import modes_of`: the folder `modes` is asked for a module `modes_of`
    if parent in new_of and new_of[parent].startswith(f"{parent}."):
        _tell(parent, new_of[parent], f"{thing} is no module there; ")


def _tell(old: str, new: str, why: str = "") -> NoReturn:
    raise ModuleNotFoundError(
        f"{why}interarea.{old} of version 0.1 is interarea.{new} since 0.2; what is public is in "
        "`import interarea as ia`, all else may change",
        name=f"interarea.{old}",
    )
