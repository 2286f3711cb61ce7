"""The public surface, frozen: a change of a name or signature is a decision, made here and in CHANGELOG."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import interarea as ia

CONTROLLER = "Controller | ControllerBank | SystemLike | str | Path"
FUNCTIONS = {
    "load_case": "name_or_path: str | Path -> Case",
    "import_case": "grid: str | Path, *, dyr: str | Path | None = None, frequency_hz: float | None = None, "
    "P_exponent: float | None = None, Q_exponent: float | None = None, strict: bool = False, "
    "island: int | str | None = None, converters: str = 'model', dc_lines: str = 'model', "
    "coordinates: str | Path | None = None, "
    "release_limits: bool = False, devices: Sequence[str | Path] = (), "
    "leave_out: Sequence[str] = (), replace: Mapping[str, str] | None = None, "
    "report: Callable[[str], object] | None = None -> Case",
    "modes": "case: Case | str | Path -> SwingModes",
    "loops": "case: Case | str | Path, *, band_hz: tuple[float, float] = (0.1, 2.5), below: float = 0.2, "
    "targets: Sequence[str] = (), "
    "signals: Sequence[str] = ('speed', 'frequency', 'angle', 'power', 'current'), "
    "actuators: Sequence[str] = (), latency_s: float = 0.0, together: int | None = None, most: int = 10, "
    "points: Mapping[str, Case] | None = None -> RankedLoops",
    "linearise": "case: Case | str | Path, *, reference: bool = False, speeds: str = 'pu' "
    "-> control.StateSpace",
    "reduce": "system: SystemLike | Case | str | Path, order: int, *, method: str = 'balanced', "
    "inputs: Sequence[str] = (), outputs: Mapping[str, Mapping[str, float]] | None = None -> Reduction",
    "design_controller": "spec: str | Path | Mapping[str, Any], *, case: Case | str | Path | None = None, "
    "progress: Callable[[str, float, str], object] | None = None -> Controller",
    "load_controller": "name: str | Path, *, case: Case | str | Path = 'two-area-thesis' "
    "-> Controller | ControllerBank",
    "certify": f"controller: {CONTROLLER}, case: Case | str | Path | None = None, *, "
    "spec: str | Path | Mapping[str, Any] | None = None, conditions: Sequence[str] = (), "
    "progress: Callable[[str, float], object] | None = None -> Certificate",
    "simulate": "scenario: str | Path | Mapping[str, Any], *, case: Case | str | Path | None = None, "
    f"controller: {CONTROLLER} | None = None, progress: Callable[[float, float], object] | None = None "
    "-> Result",
    "compare": f"controllers: Sequence[{CONTROLLER}], "
    "scenario: str | Path | Mapping[str, Any] = 'wide-area-damping', *, "
    "case: Case | str | Path | None = None, progress: Callable[[str, float], object] | None = None "
    "-> Comparison",
    "sweep": "spec: str | Path | Mapping[str, Any], *, out: str | Path, workers: int | None = None, "
    "scheduler: str | None = None, large: bool = False, "
    "progress: Callable[[Progress], object] | None = None -> SweepResults",
    "read_sweep": "folder: str | Path -> SweepResults",
    "read_record": "source: str | Path | pd.DataFrame, *, units: Mapping[str, str] | None = None, "
    "rate_hz: float | None = None, window_s: tuple[float, float] | None = None, fill_s: float = 0.5, "
    "frequency_hz: float = 60.0 -> Record",
    "meter": "record: Record | str | Path | pd.DataFrame, case: Case | str | Path | None = None, *, "
    "beside: Record | str | Path | pd.DataFrame | None = None, band_hz: tuple[float, float] = (0.1, 2.5), "
    "quantity: str | None = None, channels: Sequence[str] = () -> Meter",
    "damping_trend": "record: str | Path | pd.DataFrame, case: Case | str | Path | None = None, *, "
    "every_s: float = 600.0, window_s: tuple[float, float] | None = None, "
    "units: Mapping[str, str] | None = None, band_hz: tuple[float, float] = (0.1, 2.5), "
    "quantity: str | None = None, channels: Sequence[str] = () -> Trend",
    "fit": "record: Record | str | Path | pd.DataFrame, case: Case | str | Path, machine: str, "
    "parameters: Sequence[str] = (), *, rest_s: float = 0.5 -> Fit",
    "delay_margin": "loop: SystemLike, *, sign: int = -1, upto_s: float = 10.0 -> DelayMargin",
    "delayed_poles": "loop: SystemLike, latency_s: float | Sequence[float], *, sign: int = -1, "
    "right_of: float = -1.0, least: int = 1 -> npt.NDArray[np.complex128]",
    "hinfsyn": "plant: SystemLike, measurements: int, controls: int, *, damping_ratio: float = 0.0, "
    "decay_rate: float | None = None, radius: float | None = None -> Synthesis",
    "h2syn": "plant: SystemLike, measurements: int, controls: int -> Synthesis",
    "build_fmu": "thing: Case | Controller | ControllerBank | SystemLike | str, path: str | Path, *, "
    "case: Case | str | Path = 'two-area-thesis', platforms: Sequence[str] | None = None -> Path",
    "write_ssp": "scenario: str | Path | Mapping[str, Any], path: str | Path, *, "
    "platforms: Sequence[str] | None = None -> Path",
    "write_container": "scenario: str | Path | Mapping[str, Any], path: str | Path, *, "
    "platforms: Sequence[str] | None = None -> Path",
    "check": "path: str | Path, *, run: bool = True -> Report",
    "Controller": "name: str, system: control.StateSpace, limit_pu: float = 0.15, "
    "design: Mapping[str, Any] = <factory>, certificate: Mapping[str, Any] | None = None, "
    "guard: Guard | None = None -> None",
    "System": "*, stop_s: float, start_s: float = 0.0, step_s: float | None = None, "
    "cache: Path | None = None, arrivals: Literal['exact', 'grid'] = 'exact', strict: bool = False, "
    "**options: Any -> None",
    "Channel": "**keys: Any -> None",
    "Playback": "name: str, record: Record, channel: str, *, start_s: float, "
    "nominal_hz: float = 60.0 -> None",
}
ERRORS = {
    "InterareaError": Exception,
    "UserError": ia.InterareaError,
    "InfeasibleDesign": ia.InterareaError,
    "UncertifiedDesign": ia.InterareaError,
    "StepError": ia.InterareaError,
}
CHANNEL = (
    "signal pmu latency_s on_loss hold_s reporting_interval_s jitter_s latency loss quantum pdc_wait_s seed "
    "outages_s signal_faults"
)
METHODS = {
    "Result": "data units to_frame save explain trajectory ledger packets explanation",
    "Run": "damping_ratio settling_time_s plot stable summary unmet metrics scenario case",
    "SwingModes": "inter_area to_frame plot",
    "RankedLoops": "selected to_frame plot",
    "Comparison": "runs roots worth to_frame plot save as_dict",
    "Certificate": "ok violations rows to_frame plot as_dict",
    "SweepResults": "summary to_frame trajectory plot maps",
    "System": "plant controller fmu add channel concentrator connect event run self_test",
}


def test_there_are_these_names_and_no_others() -> None:
    assert set(ia.__all__) == {"__version__", *FUNCTIONS, *ERRORS}
    assert set(ia.__all__) <= set(dir(ia))
    with pytest.raises(AttributeError, match=r"no 'simulte'; public are load_case"):
        _ = ia.simulte  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_signatures_are_frozen(name: str) -> None:
    thing = getattr(ia, name)
    target = thing.__init__ if name == "Channel" else thing
    text = str(inspect.signature(target)).replace("(self, ", "(")
    parameters, _, result = text.rpartition(") -> ")
    plain = re.sub(r": '([^']*)'", r": \1", parameters.removeprefix("("))
    plain = re.sub(r': "([^"]*)"', r": \1", plain)
    assert f"{plain} -> {result.strip(chr(39))}" == FUNCTIONS[name]
    assert inspect.getdoc(thing), name


def test_a_channel_takes_the_keys_of_a_scenario_file() -> None:
    assert set(ia.Channel.model_fields) == set(CHANNEL.split())


@pytest.mark.parametrize("name", ERRORS)
def test_every_error_is_an_interarea_error(name: str) -> None:
    assert issubclass(getattr(ia, name), ERRORS[name])


def test_what_is_returned_has_these_methods() -> None:
    from interarea import shown
    from interarea.cosim.results.result import Result
    from interarea.cosim.results.run import Run
    from interarea.cosim.run.system import System

    classes = {c.__name__: c for c in (Result, Run, System)} | vars(shown)
    for name, members in METHODS.items():
        there = {*dir(classes[name]), *getattr(classes[name], "__dataclass_fields__", ())}
        assert set(members.split()) <= there, name


def test_no_error_of_the_package_stands_outside() -> None:
    """Every error class that can leave a function of ours is an `InterareaError`."""
    import importlib
    import pkgutil

    inside = {"CallFailed", "ImageError", "TimeUpError"}  # caught where they are raised
    floors = [importlib.import_module(f"interarea.{f}") for f in ("models", "design", "fmu_build", "cosim")]
    for module in (
        m for floor in floors for m in pkgutil.walk_packages(floor.__path__, f"{floor.__name__}.")
    ):
        for name, thing in vars(importlib.import_module(module.name)).items():
            if not isinstance(thing, type) or issubclass(thing, Warning):
                continue
            if issubclass(thing, Exception) and thing.__module__ == module.name:
                assert issubclass(thing, ia.InterareaError) or name.startswith("_") or name in inside, (
                    f"{module.name}.{name}"
                )


def test_importing_it_loads_nothing() -> None:
    code = "import sys; before = set(sys.modules); import interarea; print(*(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    ours = [m for m in done.stdout.split() if m.startswith("interarea")]
    assert ours == ["interarea"]
    heavy = {"numpy", "scipy", "pandas", "control", "pydantic", "typer", "rich"}
    assert not heavy & set(done.stdout.split())


def test_pages_and_examples_import_the_front_door_alone() -> None:
    root = Path(__file__).resolve().parents[1]
    pages = [root / "README.md", *(root / "docs").glob("*.md"), *(root / "examples").glob("*.py")]
    for page in pages:
        inner = re.findall(r"^ *(?:from|import) +interarea\.\S+", page.read_text("utf-8"), re.MULTILINE)
        assert not inner, f"{page.name}: {inner}"
