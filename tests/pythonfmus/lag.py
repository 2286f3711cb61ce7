"""A first-order lag as an FMU made by pythonfmu: no input derivatives, no slopes, no saved states."""

from math import exp

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Lag(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.T = 0.5
        self.u = 0.0
        self.y = 1.0
        self.spoil_at = 1e30
        for name in ("T", "spoil_at"):
            self.register_variable(
                Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable)
            )
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        if current_time + step_size > self.spoil_at:
            self.log("the lag was told to fail")
            return False
        self.y = self.u + (self.y - self.u) * exp(-step_size / self.T)
        return True
