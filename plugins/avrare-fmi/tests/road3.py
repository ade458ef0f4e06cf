"""Adaptive cruise control behind a car that brakes: the road as an FMU 3."""

from pythonfmu3 import Boolean, Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability, Int32


class Road(Fmi3Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time, self.gap, self.speed, self.lead, self.error = 0.0, 40.0, 25.0, 25.0, 0.0
        self.acceleration, self.radar, self.braking, self.hard, self.steps = 0.0, 0.0, 6.0, True, 0
        self.register_variable(Float64("time", causality=Fmi3Causality.independent))
        names = ("gap", "speed", "lead")
        for name in names:
            self.register_variable(Float64(name, causality=Fmi3Causality.output))
        self.register_variable(
            Float64("measured", causality=Fmi3Causality.output, getter=lambda: self.gap + self.error)
        )
        for name in ("acceleration", "radar"):
            self.register_variable(Float64(name, causality=Fmi3Causality.input))
        parameter = {"causality": Fmi3Causality.parameter, "variability": Fmi3Variability.fixed}
        discrete = {"variability": Fmi3Variability.discrete}
        self.register_variable(Float64("braking", **parameter))
        self.register_variable(Boolean("hard", **parameter))
        self.register_variable(Int32("steps", causality=Fmi3Causality.output, **discrete))
        for name in ("error",):
            self.register_variable(Float64(name, causality=Fmi3Causality.local))

    def do_step(self, time, dt):
        self.speed = max(self.speed + dt * self.acceleration, 0.0)
        braking = self.braking if self.hard and 3.0 < self.time < 7.0 else 0.0
        self.lead = max(self.lead - dt * braking, 0.0)
        self.gap += dt * (self.lead - self.speed)
        self.error = 0.95 * self.error + self.radar
        self.time += dt
        self.steps += 1
        return True
