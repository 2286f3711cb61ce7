"""The master: steps connected participants so that a connection has the latency asked for, no more, no less.

One step from t to t + H, all times whole ticks (`clock`), every known event a communication point:

1. every signal is predicted over the step (`signals`);
2. channels whose latency covers the step go first: their outputs over the step depend on the past only,
   and what they are sent at t is exact (value and slope);
3. the rest follow in dependency order (`graph`), each handed its inputs over the whole step as a cubic
   (value and three derivatives) or, where an FMU takes none, as means over parts of the step;
4. a loop without a channel is stepped on predicted signals; when what comes out differs from what was
   predicted by more than the tolerance, the FMU states are put back and the step is repeated with a
   better guess (`algebraic_loop`), until it agrees;
5. outputs are recorded.

Modes ``hold-jacobi`` and ``hold-gauss-seidel`` hold inputs instead, as most masters do; the delay that
adds is in the ledger (`ledger`).

`Master.step` is the reference, in Python. `Master.run` does the same in compiled code (`kernel`) where it
can, with the same bits.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable

import numpy as np

from ..clock import Step, seconds, to_ticks
from ..early_return import rolled_back, too_short
from ..errors import GraphError, ScenarioError, StepError
from ..participant import Participant
from ..trajectory import Trajectory
from .algebraic_loop import initialise, iterate_loop
from .fmu_log import FmuLog
from .graph import Graph, LoopSet, build_graph
from .instances import FmuParticipant
from .kernel.build import kernel_or_reason
from .kernel.kernel import Kernel, run_kernels, why_not
from .node import Node
from .plan import Engine, LoopPlan
from .records import Fork, Records, Sink, Snapshot
from .signals import Signal
from .step_choice import clock_of, latency_ticks
from .stepping import Stepping, make_nodes, make_signals

Progress = Callable[[float, float], object]


class Master:
    """Steps `participants` as `plan` says.

    Parameters
    ----------
    plan : the loop, with its instants and options.
    participants : any number, each with its own name.
    sink : takes the results in parts while the run goes on, the last when it ends; they are not kept then.

    Raises
    ------
    GraphError, ScenarioError, StepError
    """

    def __init__(
        self, plan: LoopPlan, participants: Iterable[Participant], *, sink: Sink | None = None
    ) -> None:
        self.plan = plan
        self.participants = {p.name: p for p in sorted(participants, key=lambda p: p.name)}
        descriptions = {n: p.description for n, p in self.participants.items()}
        pairs = tuple(plan.connections)
        ticks = latency_ticks(plan.latency_s, descriptions)
        self.step_s, self.step_reason = plan.chosen_step
        holds = plan.inputs.startswith("hold")
        self.clock = clock_of(
            descriptions,
            start_s=plan.start_s,
            stop_s=plan.stop_s,
            step_s=self.step_s,
            event_times_s=plan.event_times_s,
            latency_ticks=ticks,
            edges=not holds,
            points=() if holds else plan.points,
            at_rest=plan.at_rest,
        )
        self.graph: Graph = build_graph(descriptions, pairs, step_ticks=self.clock.step, latency_ticks=ticks)
        self._initial_graph = build_graph(
            descriptions, pairs, step_ticks=self.clock.stop - self.clock.start + 1
        )
        self.signals = make_signals(self.participants, self.graph, plan.inputs)
        self.nodes = make_nodes(self.participants, self.graph, self.signals, plan.inputs, plan.substeps)
        self.residual = 0.0  #: of the initial values, relative
        self.repeated = 0  #: loop steps done again since the start
        self.stepping = Stepping(
            descriptions, self.graph, self.signals, plan.inputs, plan.loops, plan.tolerance
        )
        self._order = [self._planned(group) for group in self.stepping.groups]
        self._index = -1
        self.recorded = 1 + int(np.count_nonzero(self.clock.steps.recorded))  #: points from start to end
        self._records = Records(self.participants.values(), self.recorded, sink)
        self.engine: Engine = plan.engine
        self.ran = ""  #: who did the steps since the start: kernel | python | python (why not the kernel)
        self.rolled_back = 0  #: steps put back because an FMU returned early, since the start
        self._stopping = [p for p in self.participants.values() if isinstance(p, FmuParticipant)]
        self._kernel: Kernel | None = None
        self._why_python = "early returns are rolled back" if plan.early == "roll back" else ""
        self._cancelled = False
        self.ends = self.clock.steps.ends

    # -- running --------------------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Present time."""
        return seconds(self.clock.start if self._index <= 0 else self.clock.steps[self._index - 1].end)

    @property
    def index(self) -> int:
        """Number of steps done; -1 before the start."""
        return self._index

    @property
    def finished(self) -> bool:
        return self._index >= len(self.clock.steps)

    def start(self) -> None:
        """Initialise all participants (again, if they ran before) and record the start."""
        start_s, stop_s = seconds(self.clock.start), seconds(self.clock.stop)
        self._records.count = self.repeated = self.rolled_back = 0
        self.ran = ""
        for p in self.participants.values():
            p.begin(start_s, stop_s)
        self.residual = initialise(self._initial_graph, self.nodes, self.clock.start, 1e-12)
        for p in self.participants.values():
            p.ready()
        for node in self.nodes.values():
            node.take_start(self.clock.start, slopes=True)
        self._index = 0
        self._records.add(self.clock.start)

    def step(self) -> bool:
        """Do the next communication step, in Python; return whether there was one.

        Raises
        ------
        StepError : an FMU failed or an output is not finite; its `trajectory` has the results so far.
        """
        if self._index < 0:
            self.start()
        if self.finished:
            return False
        self._note("python")
        step = self.clock.steps[self._index]
        try:
            if self.plan.early == "roll back":
                self.rolled_back += rolled_back(step, self._once, self.save, self.restore, self.release)
            else:
                self._once(step)
        except StepError as error:
            error.trajectory = self.trajectory
            raise
        self._index += 1
        if step.recorded:
            self._records.free(self.ran)
            self._records.add(step.end)
        return True

    def run(self, until_s: float | None = None, *, progress: Progress | None = None) -> Trajectory:
        """Step to `until_s` (default: the end) and return the trajectory; see `advance`."""
        self.advance(until_s, progress=progress)
        return self.trajectory

    def advance(self, until_s: float | None = None, *, progress: Progress | None = None) -> None:
        """Step to `until_s` (default: the end); `trajectory` has the results whenever they are wanted.

        progress : called with (present time, stop time) at first, then after each step in Python, and at
            least every 20 ms of computing (or after a longer step) with the kernel. It may raise, or call
            `cancel`.

        Raises
        ------
        StepError : as `step`. GraphError : engine = "kernel" where it cannot be had.
        ScenarioError : `until_s` lies before the present time.
        """
        until = self.clock.stop if until_s is None else to_ticks(until_s, "until_s")
        stop_s = seconds(self.clock.stop)
        self._cancelled = False
        if self._index < 0:
            self.start()
        now = self.clock.start if self._index == 0 else self.ends[self._index - 1]
        if until < now:
            raise ScenarioError(
                f"until_s = {until_s!r}: time does not go backwards from {seconds(now)} s; "
                "restore a saved state, or start again"
            )
        kernel = self._compiled()
        last = bisect_right(self.ends, until)
        if progress is not None:
            progress(self.time_s, stop_s)
        while self._index < last and not self._cancelled:
            if kernel is None:
                self.step()
            else:
                self._stretch(kernel, min(last, self._index + self._records.free(self.ran)))
            if progress is not None:
                progress(self.time_s, stop_s)
        if self.finished:
            self._records.hand_on(self.ran)

    # -- for `together` -------------------------------------------------------------------

    def to_kernel(self) -> Kernel | None:
        """Start if need be and make the kernel begin where this stands; None: Python has to step.

        What the kernel then does is to be followed (`sync_from_kernel`).
        """
        self._cancelled = False
        if self._index < 0:
            self.start()
        kernel = self._compiled()
        if kernel is not None:
            self._note("kernel")
            kernel.begin(self._index, self._records.count)
        return kernel

    def sync_from_kernel(self, kernel: Kernel) -> None:
        """Go where the kernel has come to."""
        self._index, self._records.count = kernel.index, kernel.row
        self.repeated += kernel.repeated

    def fail(self, error: Exception) -> None:
        """Put the results so far into the error of a step."""
        if isinstance(error, StepError):
            error.trajectory = self.trajectory

    @property
    def cancelled(self) -> bool:
        """Whether `cancel` was called since the steps under way began."""
        return self._cancelled

    def cancel(self) -> None:
        """Make `run` return after the step it is in; to be called by `progress` or from another thread."""
        self._cancelled = True
        if self._kernel is not None:
            self._kernel.cancel()

    @property
    def fmu_logs(self) -> list[FmuLog]:
        """What FMUs and DLLs logged since the start, in the order of their names."""
        logs = (getattr(p, "log", None) for p in self.participants.values())
        return [log for log in logs if isinstance(log, FmuLog)]

    def detach(self) -> None:
        """Free the states that the master keeps of its participants, which another master takes over."""
        if self._kernel is not None:
            self._kernel.close()
            self._kernel = None

    def close(self) -> None:
        """End all participants."""
        self.detach()
        for p in self.participants.values():
            p.close()

    def __enter__(self) -> Master:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def trajectory(self) -> Trajectory:
        """Results up to now: every output of every participant; with a sink, those not yet handed on."""
        return self._records.trajectory(self.ran)

    # -- saving ---------------------------------------------------------------------------

    def save(self) -> Snapshot:
        """Return the state between two steps, to `restore` as often as wanted (fork a run)."""
        if self._index < 0:
            self.start()
        for n, p in self.participants.items():
            if not p.description.saves_state:
                raise GraphError(
                    f"{n} cannot save its state (canGetAndSetFMUstate): this run cannot be forked"
                )
        states = {n: p.save() for n, p in self.participants.items()}
        return Snapshot(self._index, states, tuple(s.copy() for s in self.signals), self._records.count)

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to `saved`; the records up to then are kept as they are."""
        for n, p in self.participants.items():
            p.restore(snapshot.states[n])
        for s, retained in zip(self.signals, snapshot.signals, strict=True):
            s.paste(retained)
        self._index, self._records.count = snapshot.index, snapshot.rows

    def release(self, snapshot: Snapshot) -> None:
        """Free the participants' part of `saved`."""
        for n, p in self.participants.items():
            p.release(snapshot.states[n])

    def fork(self) -> Fork:
        """Return the beginning up to now, for `take_over`; `release` its `saved` when it is not needed."""
        snapshot = self.save()
        counts = (self.residual, self.repeated, self.rolled_back, self.ran)
        times, records = (a[: snapshot.rows].copy() for a in (self._records.times, self._records.values))
        return Fork(snapshot, self.ends[: snapshot.index], times, records, counts)

    def take_over(self, fork: Fork) -> bool:
        """Go on from another master's beginning as if it were this one's; both have the same structure.
        False: nothing was done: other communication points up to there, or an FMU in another process."""
        snapshot = fork.snapshot
        if self.ends[: snapshot.index] != fork.ends or len(self._stopping) < len(self.participants):
            return False
        for p in self._stopping:
            p.resume(seconds(fork.ends[-1] if fork.ends else self.clock.start))
        self.restore(snapshot)
        self._records.times[: snapshot.rows] = fork.times
        self._records.values[: snapshot.rows] = fork.records
        self.residual, self.repeated, self.rolled_back, self.ran = fork.counts
        return True

    # -- private --------------------------------------------------------------------------

    def _planned(self, group: LoopSet) -> tuple[LoopSet, list[Node], list[Signal] | None]:
        """Return a group, its nodes, and when it is iterated its tearing signals."""
        iterated = group.members in self.stepping.iterated
        tearing = self.stepping.tearing_signals(group) if iterated else None
        return group, [self.nodes[n] for n in group.members], tearing

    def _once(self, step: Step) -> None:
        """Do one step, and no more."""
        if self.plan.early == "roll back":
            for p in self._stopping:
                p.stops_early = not too_short(step)
        for s in self.signals:
            s.begin(step.start, step.edge)
        for group, nodes, tearing in self._order:
            if tearing is None:
                for node in nodes:
                    node.advance(step)
            else:
                self.repeated += iterate_loop(group, self.nodes, tearing, step, self.plan.tolerance)
        for s in self.signals:
            s.accept(step.start, step.end, step.edge)

    def _compiled(self) -> Kernel | None:
        """Return the kernel for the present instances, or None where Python has to step them."""
        if self.engine == "python" or self._why_python:
            return None
        if self._kernel is not None:
            if self._kernel.fits():
                self._kernel.cancel(False)
                return self._kernel
            self._kernel = None
        reason = why_not(self.nodes)
        library = None
        if not reason:
            library, reason = kernel_or_reason()
        if library is None:
            if self.engine == "kernel":
                raise GraphError(f'engine = "kernel" cannot step this: {reason}; use engine = "auto"')
            self._why_python = reason
            return None
        self._kernel = Kernel(
            library,
            self.nodes,
            self.signals,
            self.stepping.groups,
            self.stepping.tearing_signals,
            self.stepping.iterated,
            self.clock.steps,
            tolerance=self.plan.tolerance,
            times=self._records.times,
            records=self._records.values,
        )
        return self._kernel

    def _stretch(self, kernel: Kernel, last: int) -> None:
        """Let the kernel step for a while."""
        self._note("kernel")
        kernel.begin(self._index, self._records.count)
        try:
            error = run_kernels([kernel], [last])[0]
        finally:  # Ctrl-C too
            self.sync_from_kernel(kernel)
        if error is not None:
            self.fail(error)
            raise error

    def _note(self, engine: str) -> None:
        """Remember who steps."""
        if engine == "python" and self._why_python:
            engine = f"python ({self._why_python})"
        if engine not in self.ran:
            self.ran = f"{self.ran}, then {engine}" if self.ran else engine
