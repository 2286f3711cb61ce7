"""How the command line starts: nothing imported before it is needed, help, completion, stopping."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest

from interarea.cli import app
from interarea.cli.app import COMMANDS, load
from interarea.cosim.run.artefacts import linear_matrices
from interarea.models.case.case import load_case

HEAVY = {"numpy", "scipy", "pandas", "control", "pydantic", "rich.console", "matplotlib", "cvxpy", "fmpy"}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_line_of_help_is_the_docstrings_first(name: str) -> None:
    command = load(name)
    assert command.name == name
    assert command.help.splitlines()[0] == COMMANDS[name][1]
    assert {"quiet", "verbose"} <= {p.name for p in command.params}


def test_little_is_loaded_before_signals_are_handled() -> None:
    """A signal that comes earlier ends Python with a traceback of its own."""
    code = "import sys; old = set(sys.modules); import interarea.__main__; print(*(set(sys.modules) - old))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) <= {
        "interarea",
        "interarea.__main__",
        "atexit",
        "signal",
        "_signal",
        "enum",
    }


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", ""])
def test_a_stopped_command_does_not_take_its_modules_down(name: str) -> None:
    """Threads of a module in C that are at work then end Python by SIGABRT."""
    stops = f"signal.{name}" if name else ""
    code = (
        f"import atexit, signal, sys, interarea.__main__ as m; atexit.register(m._keep_code, [{stops}])\n"
        "class Late:\n"
        "    def __del__(self): print('taken down', flush=True)\n"
        "sys.modules['late'] = Late(); print('written'); sys.exit(130)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 128 + (getattr(signal, name) if name else signal.SIGINT), done.stderr
    assert done.stdout.split("\n")[:-1] == (["written"] if name else ["written", "taken down"])


def _loaded(*arguments: str) -> tuple[subprocess.CompletedProcess[str], set[str]]:
    """Run a command; return how it ended and the modules that it loaded."""
    code = (
        "import sys, atexit\n"
        "atexit.register(lambda: print(*sys.modules, file=sys.stderr))\n"
        f"sys.argv = ['interarea', *{arguments!r}]\n"
        "from interarea.__main__ import main\nmain()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    return done, set(done.stderr.split())


@pytest.mark.parametrize("arguments", [("--version",), ("--help",), ("list",), ("modes", "--help")])
def test_nothing_heavy_is_loaded_for(arguments: tuple[str, ...]) -> None:
    done, modules = _loaded(*arguments)
    assert done.stdout and done.returncode == 0
    assert not HEAVY & modules


#: command whose name or file there is not; what would read it takes up to 4 s to load
WRONG = [
    *("study thesiss --out x", "study nets-nyp --out x", "study x.toml --out x", "study x.raw --out x"),
    *("study worth --grid x.raw --out x", "study actuators --grid nets-nyp --out x"),
    *("new study x.raw --out x.toml", "run wide_are", "run x.toml", "build two-area-thesi --out x"),
    *("build two-area-thesis --controller robus --out x", "design robus --out x.json"),
    *("design x.toml --out x.json", "certify robus", "certify x.fmu", "certify robust --case two-area-thesi"),
    *("certify robust --spec robus", "modes two-area-thesi", "modes two-area-thesis --controller robus"),
    *("loops x.toml", "screen two-area-thesi --out x", "screen two-area-thesis --controller robus --out x"),
    *("compare none robus", "compare none robust --scenario wide_are", "explore two-area-thesi --out x.html"),
    *("locate x.csv", "meter x.parquet", "fit x.csv --case two-area-thesis --machine G1"),
    *("sweep x.toml --out x", "maps x", "ssp wide_are --out x.ssp", "container x.toml --out x.fmu"),
    *("check x.fmu", "import x.raw --out x.toml", "export two-area-thesi --out x.raw", "device x.toml"),
]


@pytest.mark.parametrize("command", WRONG)
def test_a_wrong_name_is_refused_before_what_would_read_it_is_loaded(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done, modules = _loaded(*command.split())
    assert done.returncode == 2, done.stderr
    assert not {"scipy", "pandas", "control", "matplotlib", "cvxpy"} & modules
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_numpy_and_scipy_calculate_in_one_thread_unless_more_are_asked_for() -> None:
    code = (
        "import atexit, os, sys\n"
        "def told():\n"
        "    import numpy, scipy.linalg, threadpoolctl\n"
        "    pools = {p['num_threads'] for p in threadpoolctl.threadpool_info()}\n"
        "    print(os.environ['OPENBLAS_NUM_THREADS'], pools, file=sys.stderr)\n"
        "atexit.register(told)\n"
        "sys.argv = ['interarea', '--version']\n"
        "from interarea.__main__ import main\nmain()"
    )
    own = {k: v for k, v in os.environ.items() if k not in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")}

    def said(**more: str) -> str:
        done = subprocess.run([sys.executable, "-c", code], env=own | more, capture_output=True, check=False)
        return done.stderr.decode().strip()

    assert said() == "1 {1}"
    assert said(OPENBLAS_NUM_THREADS="7").startswith("7 ")


@pytest.mark.slow
@pytest.mark.parametrize(
    "lines",
    [
        "stp_s = 0.01",
        "stop_s = -1.0",
        '[[event]]\nkind = "vref_pulze"',
        '[channels.remote]\nsignal = "G2_dw"\nlatency_s = "long"',
        "[concentrators.pdc]\nsignals = []",
        'controller = "wdcc"',
        'controller = "robust"\n[[event]]\nkind = "vref_step"\nmachine = "G9"\nsize_pu = 0.1\nstart_s = 1.0',
        'swing = ["G1", "G9"]',
        '[operating_point]\nout = ["8-9"]',
    ],
)
def test_a_mistake_in_a_scenario_is_told_before_numbers_are_loaded(tmp_path: Path, lines: str) -> None:
    stop = "" if "stop_s" in lines else "stop_s = 2.0\n"
    file = tmp_path / "wrong.toml"
    file.write_text(f'case = "two-area-thesis"\n{stop}{lines}\n', encoding="utf-8")
    done, modules = _loaded("run", str(file), "--out", str(tmp_path / "out"))
    assert done.returncode == 2 and "interarea: " in done.stderr
    assert not (HEAVY - {"pydantic"}) & modules


def test_a_wrong_name_is_told_with_what_only_the_fmus_know_to_be_wrong(interarea, tmp_path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "wrong.toml"
    file.write_text(
        'case = "two-area-thesis"\nstop_s = 2.0\nrecord = ["plant.G9_*"]\n'
        '[[event]]\nkind = "vref_step"\nmachine = "G9"\nsize_pu = 0.1\nstart_s = 1.0\n',
        encoding="utf-8",
    )
    code, _, err = interarea("run", str(file), "--out", str(tmp_path / "out"))
    assert code == 2
    assert "machine 'G9' does not exist" in err and "plant.G9_*" in err


@pytest.mark.slow
def test_modes_of_a_case_known_already_take_no_library_of_systems_and_no_plots(cache: Path) -> None:
    linear_matrices(load_case("two-area-thesis"), cache)
    done, modules = _loaded("modes", "two-area-thesis")
    assert "inter-area" in done.stdout
    assert not {"control", "matplotlib", "pandas", "cvxpy", "fmpy"} & modules


@pytest.mark.slow
def test_a_plain_run_loads_what_it_needs(tmp_path: Path) -> None:
    words = ("run", "ring-down", "--out", str(tmp_path))
    assert not {"control", "pandas", "cvxpy", "clarabel", "fmpy"} & _loaded(*words)[1]
    done, modules = _loaded(*words)  # with all in the cache
    assert "report.html" in done.stdout and "matplotlib.figure" in modules
    assert not {"scipy.optimize", "scipy.integrate", "ziglang", "lxml", "xmlschema"} & modules


def test_figures_are_loaded_without_the_help_on_their_properties() -> None:
    """Of the properties that `Axes.plot` names in its docstring; what lists them is put back."""
    code = (
        "from interarea.cosim.plots.loading import load_plots\n{}"
        "from matplotlib import artist, axes, lines\n"
        "print('antialiased' in axes.Axes.plot.__doc__, "
        "'antialiased' in artist.kwdoc(lines.Line2D))"
    )
    for call, shown in (("load_plots()\n", "False"), ("", "True")):
        done = subprocess.run(
            [sys.executable, "-c", code.format(call)], capture_output=True, text=True, check=True
        )
        assert done.stdout.split() == [shown, "True"]


def _output(*arguments: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "interarea", *arguments],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )
    return done.stdout


def test_python_dash_m_is_the_command() -> None:
    import interarea

    assert _output("--version") == f"interarea {interarea.__version__}\n"
    assert _output("--help").startswith("Usage: interarea [OPTIONS] COMMAND")


@pytest.mark.slow
def test_the_shell_completes_commands_and_options() -> None:
    environment = {"_INTERAREA_COMPLETE": "complete_bash", "COMP_CWORD": "1"}
    assert _output(COMP_WORDS="interarea con", **environment).split() == ["container"]
    environment["COMP_CWORD"] = "2"
    assert _output(COMP_WORDS="interarea modes --sha", **environment).split() == ["--shapes"]
    # the shell is looked for among the parents of the process: `true` keeps bash there
    shown = ["bash", "-c", f"{sys.executable} -m interarea --show-completion; true"]
    assert "complete_bash" in subprocess.run(shown, capture_output=True, text=True, check=False).stdout


def test_quiet_leaves_results_and_verbose_tells_steps(interarea, tmp_path) -> None:  # type: ignore[no-untyped-def]
    assert interarea("modes", "two-area-thesis", "--quiet")[2] == ""
    assert "linearising the plant FMU" in interarea("modes", "two-area-thesis", "--verbose")[2]
    _, _, err = interarea("modes", "kundr", "--verbose")
    assert "Traceback" in err and err.rstrip().splitlines()[-1].startswith("interarea: case 'kundr'")


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no SIGINT to a child on Windows")
@pytest.mark.parametrize("after_s", [0.15, 0.4, 0.8])
def test_a_stop_in_the_first_moments_gives_no_traceback(after_s: float) -> None:
    code = (
        "import interarea.__main__ as m, sys; print('on', flush=True); "
        "sys.argv = ['interarea', 'modes', 'nets-nyps']; m.main()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == "on\n"
        time.sleep(after_s)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert "Traceback" not in err
    assert process.returncode in (0, 130, -signal.SIGINT)  # 0: it was done before; the last: at its very end


@pytest.mark.skipif(os.name == "nt", reason="no SIGINT to oneself on Windows")
def test_a_stop_that_a_module_makes_an_error_of_is_still_a_stop() -> None:
    code = """if True:
        import os, signal, interarea.__main__ as start, interarea.cli.app as app
        def loading(prog_name):
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except KeyboardInterrupt:
                raise ImportError("a module in C") from None
        app.app = loading
        start.main()
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "interarea: stopped\n")


@pytest.mark.skipif(os.name == "nt", reason="no SIGTERM to oneself on Windows")
def test_a_stop_in_code_that_a_module_in_c_runs_keeps_its_exit_code(tmp_path: Path) -> None:
    """Python would end itself by SIGINT: PyRun_String notes the KeyboardInterrupt that passes through it."""
    (tmp_path / "stopped_inside.py").write_text(
        """if True:
        import ctypes, signal, sys
        from interarea import __main__
        from interarea.cli import app
        inner = ctypes.pythonapi.PyRun_String
        inner.restype = ctypes.py_object
        inner.argtypes = [ctypes.c_char_p, ctypes.c_int, ctypes.py_object, ctypes.py_object]
        CODE = b"import os, signal\\nos.kill(os.getpid(), signal.SIGTERM)\\nfor k in range(1000): pass\\n"
        def run(stops):
            try:
                inner(CODE, 257, {}, {})
            except KeyboardInterrupt:
                sys.exit(128 + stops[0])
        app.main = run
        __main__.main()
        """
    )
    command = [sys.executable, "-m", "stopped_inside"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (128 + signal.SIGTERM, "")


def test_a_panic_of_a_module_in_rust_ends_as_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """pydantic's panics where memory runs out, and what comes out of it is no Exception."""

    class PanicException(BaseException):
        pass

    def panics(**_: object) -> None:
        raise PanicException("PyObject pointer is null")

    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # which main sets
    monkeypatch.setattr(app, "app", panics)
    with pytest.raises(SystemExit) as ended:
        app.main()
    assert ended.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(
        "interarea: internal error, please report it: PanicException: PyObject pointer is null"
    )
