"""Adaptive cruise control behind a car that brakes: the road as an FMU."""

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real


class Road(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time, self.gap, self.speed, self.lead, self.error = 0.0, 40.0, 25.0, 25.0, 0.0
        self.acceleration, self.radar, self.braking, self.hard, self.steps = 0.0, 0.0, 6.0, True, 0
        names = ("gap", "speed", "lead")
        for name in names:
            self.register_variable(Real(name, causality=Fmi2Causality.output))
        self.register_variable(
            Real("measured", causality=Fmi2Causality.output, getter=lambda: self.gap + self.error)
        )
        for name in ("acceleration", "radar"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        parameter = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
        discrete = {"variability": Fmi2Variability.discrete}
        self.register_variable(Real("braking", **parameter))
        self.register_variable(Boolean("hard", **parameter))
        self.register_variable(Integer("steps", causality=Fmi2Causality.output, **discrete))
        for name in ("time", "error"):
            self.register_variable(Real(name, causality=Fmi2Causality.local))

    def do_step(self, time, dt):
        self.speed = max(self.speed + dt * self.acceleration, 0.0)
        braking = self.braking if self.hard and 3.0 < self.time < 7.0 else 0.0
        self.lead = max(self.lead - dt * braking, 0.0)
        self.gap += dt * (self.lead - self.speed)
        self.error = 0.95 * self.error + self.radar
        self.time += dt
        self.steps += 1
        return True
