"""Adaptive cruise control as an FMU."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Cruise(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.gap, self.speed, self.lead, self.acceleration = 0.0, 0.0, 0.0, 0.0
        for name in ("gap", "speed", "lead"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        self.register_variable(Real("acceleration", causality=Fmi2Causality.output))

    def do_step(self, time, dt):
        wanted = 0.3 * (self.gap - 3.0 - 1.3 * self.speed) + (self.lead - self.speed)
        self.acceleration = min(max(wanted, -8.0), 2.0)
        return True
