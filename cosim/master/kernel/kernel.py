"""The master's steps in compiled code: the algorithm of `master`, the arithmetic of `signals`, the same bits.

The kernel works on the same FMU instances, the same output buffers and the
same records as the Python reference. What the master remembers of each signal
is copied in before a stretch of steps and back after it, so that either can go
on where the other stopped, at any communication point. One call runs for at
most 20 ms, without the interpreter lock; between calls Python handles Ctrl-C
and tells progress. Several kernels can run in one call (`run_kernels`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Collection, Mapping, Sequence
from ctypes import addressof, byref, c_double, c_int, c_int32, c_int64, c_uint, c_void_p
from typing import Any

import numpy as np
import numpy.typing as npt

from ...clock import Steps
from ..algebraic_loop import not_settled
from ..graph import LoopSet
from ..instances import FmuParticipant
from ..node import Node
from ..signals import Signal
from . import build as built

_BUDGET_S = 0.02
MOST_TOGETHER = 64  #: kernel.c
Records = npt.NDArray[np.float64]


def why_not(nodes: Mapping[str, Node]) -> str:
    """Return why these participants cannot be stepped by the kernel; empty when they can."""
    for name, node in nodes.items():
        if type(node.participant) is not FmuParticipant:
            return f"{name} is not an FMU in this process"
    return ""


class Kernel:
    """The compiled counterpart of a `Master`'s nodes, signals and groups, for participants that have begun.

    tearing : of each group the signals that run against its order; iterated : members of the groups iterated.
    times, records : where each recorded point gets its row.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        nodes: Mapping[str, Node],
        signals: Sequence[Signal],
        groups: Sequence[LoopSet],
        tearing: Callable[[LoopSet], Sequence[Signal]],
        iterated: Collection[tuple[str, ...]],
        steps: Steps,
        *,
        tolerance: float,
        times: Records,
        records: Records,
    ) -> None:
        self._library = library
        self._nodes = tuple(nodes.values())
        self._signals = tuple(signals)
        self._groups = tuple(groups)
        self._steps = steps
        self._keep: list[Any] = [times, records]
        self.components = _components(self._nodes)
        number = {s.name: k for k, s in enumerate(signals)}
        place = {name: k for k, name in enumerate(nodes)}
        self._k_signals = (built.KernelSignal * max(1, len(signals)))()
        for mirror, s in zip(self._k_signals, signals, strict=False):
            mirror.kind, mirror.index, mirror.slope = built.KIND_OF[s.kind], s.index, s.slope_index
            mirror.nominal = s.nominal
        self._k_nodes = (built.KernelNode * len(self._nodes))()
        column = 0
        for mirror, node in zip(self._k_nodes, self._nodes, strict=True):
            self._fill_node(mirror, node, number)
            mirror.column = column
            column += mirror.n_y
        k_groups = (built.KernelGroup * max(1, len(groups)))()
        members: list[int] = []
        against: list[int] = []
        most = 0
        for mirror, group in zip(k_groups, groups, strict=False):
            mirror.first, mirror.count, mirror.tearing = len(members), len(group.members), len(against)
            members += [place[name] for name in group.members]
            if group.members in iterated:
                mirror.iterated = 1
                against += [number[s.name] for s in tearing(group)]
                mirror.n_tearing = len(against) - mirror.tearing
                most = max(most, 2 * mirror.n_tearing)
        run = self._run = built.KernelRun()
        run.discarded = built.DISCARDED(self._discarded)
        self._raised: BaseException | None = None
        run.nodes, run.signals = self._at(self._k_nodes), self._at(self._k_signals)
        run.groups = self._at(k_groups)
        run.members, run.tearing = self._at(_array(c_int32, members)), self._at(_array(c_int32, against))
        points = np.insert(np.frombuffer(steps.ends, dtype=np.int64), 0, steps.start)
        flags = (built.STEP_EDGE * steps.edge + built.STEP_RECORDED * steps.recorded).astype(np.uint8)
        self._keep += [points, flags]
        run.points, run.flags = points.ctypes.data, flags.ctypes.data
        run.times, run.records = times.ctypes.data, records.ctypes.data
        run.spare = self._at(_array(c_double, [0.0] * records.shape[1]))
        run.work = self._at((c_double * max(1, most * most + 6 * most))())
        run.tolerance = tolerance
        run.n_nodes, run.n_signals, run.n_groups = len(self._nodes), len(signals), len(groups)
        run.n_columns = records.shape[1]

    # -- running --------------------------------------------------------------------------

    def begin(self, index: int, row: int) -> None:
        """Prepare for `run_kernels` from step number `index` on; rows are written from `row` on."""
        run = self._run
        run.index, run.row, run.repeated = index, row, 0

    def cancel(self, stop: bool = True) -> None:
        """Make a run that another thread is in return after its present step; False: forget it."""
        self._run.stop = stop

    @property
    def index(self) -> int:
        """Number of the next step."""
        return int(self._run.index)

    @property
    def row(self) -> int:
        """Number of the next row."""
        return int(self._run.row)

    @property
    def repeated(self) -> int:
        """Loop steps done again in the last `run`."""
        return int(self._run.repeated)

    def fits(self) -> bool:
        """Whether the participants are still the instances this was made for."""
        return self.components == _components(self._nodes)

    @property
    def participants(self) -> list[FmuParticipant]:
        """Participants by number."""
        return [node.participant for node in self._nodes]  # type: ignore[misc]

    def join(self, number: int, step: int, work: int) -> None:
        """Step participant `number` by the function at `step`, with the others that join `work`."""
        self._k_nodes[number].lanes, self._k_nodes[number].work = step, work

    def leave(self) -> None:
        """Step every participant alone again."""
        for mirror in self._k_nodes:
            mirror.lanes = mirror.work = None

    def close(self) -> None:
        """Free the FMU states that iterating loops left, while the instances live."""
        if self.fits():
            for mirror, node in zip(self._k_nodes, self._nodes, strict=True):
                if mirror.state:
                    node.participant.release(c_void_p(mirror.state))
                    mirror.state = None

    # -- private --------------------------------------------------------------------------

    def _at(self, array: Any) -> int:
        """Keep a ctypes array alive and return its address."""
        self._keep.append(array)
        return addressof(array)

    def _fill_node(self, mirror: built.KernelNode, node: Node, number: Mapping[str, int]) -> None:
        p: FmuParticipant = node.participant  # type: ignore[assignment]
        mirror.component = p.component
        for field, name in built.FUNCTIONS.items():
            setattr(mirror, field, p.address(name))
        mirror.order, mirror.substeps = node.order, node.substeps
        self._fill_inputs(mirror, node, p, number)
        self._fill_outputs(mirror, node, p)
        own = [number[s.name] for s in node.signals]
        mirror.n_signals, mirror.first_signal = len(own), min(own, default=0)
        if own != list(range(mirror.first_signal, mirror.first_signal + len(own))):
            raise AssertionError(f"signals of {p.name} are not adjacent: {own}")

    def _fill_inputs(
        self, mirror: built.KernelNode, node: Node, p: FmuParticipant, number: Mapping[str, int]
    ) -> None:
        """Feeds and buffers of the inputs, the Real ones first."""
        known, names = p.file.variables, p.bound_inputs
        feeds = sorted(node.feeds, key=lambda f: (known[names[f.place]].type != "Real", f.place))
        bound = [known[names[f.place]] for f in feeds]
        k_feeds = (built.KernelFeed * max(1, len(feeds)))()
        for k_feed, feed, variable in zip(k_feeds, feeds, bound, strict=False):
            k_feed.gain, k_feed.offset = feed.gain, feed.offset
            k_feed.signal, k_feed.type = number[feed.signal.name], built.TYPE_OF[variable.type]
        reals = [v.reference for v in bound if v.type == "Real"]
        mirror.n_u, mirror.n_u_real = len(feeds), len(reals)
        mirror.feeds = self._at(k_feeds)
        mirror.u_reference = self._at(_array(c_uint, [v.reference for v in bound]))
        mirror.u = self._at(_array(c_double, [0.0] * len(reals)))
        orders = range(1, node.order + 1)
        mirror.du_reference = self._at(_array(c_uint, [r for r in reals for _ in orders]))
        mirror.du_order = self._at(_array(c_int, [k for _ in reals for k in orders]))
        mirror.du = self._at(_array(c_double, [0.0] * (len(reals) * node.order)))

    def _fill_outputs(self, mirror: built.KernelNode, node: Node, p: FmuParticipant) -> None:
        """Places and buffers of the outputs by type, and of the slopes."""
        known, d = p.file.variables, p.description
        kinds = [known[port.name].type for port in d.outputs]
        by_type = [
            [j for j, kind in enumerate(kinds) if built.TYPE_OF[kind] == number_of] for number_of in range(3)
        ]
        places = [j for part in by_type for j in part]
        mirror.n_real, mirror.n_integer, mirror.n_boolean = (len(part) for part in by_type)
        mirror.n_y = len(d.outputs)
        mirror.y = mirror.y_home = self._at(p.y)
        mirror.dy = self._at(p.dy)
        mirror.y_place = self._at(_array(c_int32, places))
        mirror.y_reference = self._at(_array(c_uint, [known[d.outputs[j].name].reference for j in places]))
        mirror.y_real = self._at(_array(c_double, [0.0] * mirror.n_real))
        mirror.y_integer = self._at(_array(c_int, [0] * (mirror.n_y - mirror.n_real)))
        mirror.n_dy = len(p.bound_slopes) if node.has_slopes else 0
        mirror.dy_reference = self._at(_array(c_uint, [known[n].reference for n in p.bound_slopes]))
        mirror.dy_order = self._at(_array(c_int, [1] * len(p.bound_slopes)))

    def _load(self) -> None:
        for mirror, s in zip(self._k_signals, self._signals, strict=False):
            mirror.v0, mirror.s0, mirror.v1, mirror.s1 = s.v0, s.s0, s.v1, s.s1
            mirror.d[:] = s.d
            mirror.h_last, mirror.peak = s.h_last, s.peak
            n = mirror.n_past = len(s.ticks)
            mirror.ticks[:n], mirror.values[:n] = s.ticks, s.values
        for mirror, node in zip(self._k_nodes, self._nodes, strict=True):
            mirror.time = node.participant.time_s  # type: ignore[attr-defined]
            node.participant.kernel_node = mirror  # type: ignore[attr-defined]

    def _store(self) -> None:
        for mirror, s in zip(self._k_signals, self._signals, strict=False):
            s.v0, s.s0, s.v1, s.s1 = mirror.v0, mirror.s0, mirror.v1, mirror.s1
            d = mirror.d
            s.d = (d[0], d[1], d[2], d[3])
            s.h_last, s.peak = mirror.h_last, mirror.peak
            n = mirror.n_past
            s.ticks, s.values = mirror.ticks[:n], mirror.values[:n]
        for mirror, node in zip(self._k_nodes, self._nodes, strict=True):
            p: FmuParticipant = node.participant  # type: ignore[assignment]
            p.time_s, p.kernel_node = mirror.time, None
            for call, times in zip(built.CALLS, mirror.warnings, strict=True):
                if times:
                    p.log.warned(call, mirror.first_warning, times)
            mirror.warnings[:] = [0] * len(built.CALLS)

    def _discarded(self, number: int, time_s: float, length_s: float) -> int:
        """Let the participant finish a step that was discarded; called by the kernel."""
        try:
            mirror, node = self._k_nodes[number], self._nodes[number]
            p: FmuParticipant = node.participant  # type: ignore[assignment]
            u = (c_double * mirror.n_u_real).from_address(mirror.u)
            du = (c_double * (mirror.n_u_real * mirror.order)).from_address(mirror.du)
            reals = [f.place for f in node.feeds if p.file.variables[p.bound_inputs[f.place]].type == "Real"]
            for k, place in enumerate(reals):
                p.u[place] = u[k]
                for m in range(mirror.order):
                    p.du[3 * place + m] = du[mirror.order * k + m]
            p.sent_order = mirror.order
            p.discarded(time_s, length_s)
        except BaseException as error:  # raised again by `run`
            self._raised = error
            return 1
        return 0

    def _error(self, code: int) -> Exception | None:
        """Return what a run that ended with `code` has to raise."""
        if code in (built.OK, built.PAUSED, built.STOPPED):
            return None
        try:
            self._fail(code)
        except Exception as error:
            return error
        return None

    def _fail(self, code: int) -> None:
        if self._raised is not None:
            raised, self._raised = self._raised, None
            raise raised
        run = self._run
        step = self._steps[run.index]
        if code == built.NOT_SETTLED:
            raise not_settled(self._groups[run.group], run.value, self._run.tolerance, step)
        node = self._nodes[run.node]
        if code == built.NOT_FINITE:
            node.check(step.end)
        node.participant.fail(built.CALLS[run.call], run.status)  # type: ignore[attr-defined]


def run_kernels(
    kernels: Sequence[Kernel], until: Sequence[int], *, budget_s: float = _BUDGET_S
) -> list[Exception | None]:
    """Let each kernel step towards its step number `until`, for at most `budget_s` in all; return errors.

    Participants that joined the same group (`Kernel.join`) are stepped at once. A step that an FMU discards
    is handed to its participant, as the reference does. `index`, `row` and `repeated` of each kernel then say
    how far it came. Errors are StepErrors: an FMU failed, an output is not finite, a loop does not settle.
    """
    n = len(kernels)
    codes = (c_int32 * n)()
    for kernel in kernels:
        kernel._load()
    try:
        if n == 1:
            kernels[0]._run.budget = budget_s
            codes[0] = kernels[0]._library.kernel_run(byref(kernels[0]._run), until[0])
        else:
            runs = (c_void_p * n)(*(addressof(k._run) for k in kernels))
            if kernels[0]._library.kernel_run_lockstep(runs, (c_int64 * n)(*until), n, budget_s, codes):
                raise ValueError(f"{n} runs together, allowed: {MOST_TOGETHER}")
    finally:
        for kernel in kernels:
            kernel._store()
    return [kernel._error(code) for kernel, code in zip(kernels, codes, strict=True)]


def _components(nodes: Sequence[Node]) -> list[int]:
    return [n.participant.component for n in nodes]  # type: ignore[attr-defined]


def _array(kind: Any, values: Sequence[float]) -> Any:
    """Return a ctypes array, of at least one element so that its address is one."""
    return (kind * max(1, len(values)))(*values)
