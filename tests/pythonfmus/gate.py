"""Inputs and outputs of every type: passes u on while the gate is open, counts its steps."""

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real


class Gate(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u, self.open, self.add = 0.0, True, 1
        self.last, self.total, self.even, self.y = 0.0, 0, True, 0.0
        self.nan_at = 1e30
        parameter, tunable = Fmi2Causality.parameter, Fmi2Variability.tunable
        self.register_variable(Real("nan_at", causality=parameter, variability=tunable))
        moving = {Real: Fmi2Variability.continuous}
        for make, name in ((Real, "u"), (Boolean, "open"), (Integer, "add")):
            varies = moving.get(make, Fmi2Variability.discrete)
            self.register_variable(make(name, causality=Fmi2Causality.input, variability=varies))
        for make, name in ((Real, "last"), (Integer, "total"), (Boolean, "even"), (Real, "y")):
            varies = moving.get(make, Fmi2Variability.discrete)
            self.register_variable(make(name, causality=Fmi2Causality.output, variability=varies))

    def do_step(self, current_time, step_size):
        self.last = current_time + step_size
        self.total += self.add
        self.even = self.total % 2 == 0
        self.y = self.u if self.open else -1.0
        if self.last >= self.nan_at:
            self.y = float("nan")
        return True
