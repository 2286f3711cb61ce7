"""A damping controller as an FMU made by pythonfmu: y follows gain * u with a lag T, exactly for held u."""

from math import exp

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Damper(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.gain = 10.0
        self.T = 0.1
        self.u = 0.0
        self.y = 0.0
        for name in ("gain", "T"):
            self.register_variable(
                Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable)
            )
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        goal = self.gain * self.u
        self.y = goal + (self.y - goal) * exp(-step_size / self.T)
        return True
