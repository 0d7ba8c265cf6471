"""Buffer of the shepherds' commands: answers to the present state, and ages (no rclpy)."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class CommandBuffer:
    """Last command of each shepherd, and whether it answers the present state."""

    n_shepherds: int
    velocities: list[tuple[float, float]] = field(init=False)  # m/s, zero before the first
    answered: list[bool] = field(init=False)
    age: list[int] = field(init=False)  # steps since the last command; huge if there was none

    NEVER = 1 << 30

    def __post_init__(self) -> None:
        """Start without any command."""
        self.velocities = [(0.0, 0.0)] * self.n_shepherds
        self.answered = [False] * self.n_shepherds
        self.age = [self.NEVER] * self.n_shepherds

    def expect(self) -> None:
        """Wait for the commands for a new state."""
        self.answered = [False] * self.n_shepherds
        self.age = [min(age + 1, self.NEVER) for age in self.age]

    def add(self, shepherd: int, velocity: tuple[float, float]) -> None:
        """Store a command for the present state; a later one replaces it."""
        self.velocities[shepherd] = velocity
        self.answered[shepherd] = True
        self.age[shepherd] = 0

    @property
    def complete(self) -> bool:
        """Return whether every shepherd has answered."""
        return all(self.answered)

    def silent(self) -> list[int]:
        """Return the shepherds that have not answered."""
        return [h for h, answered in enumerate(self.answered) if not answered]

    def held(self, watchdog_steps: int) -> list[tuple[float, float]]:
        """Return the last commands (H) m/s, zero for those older than the watchdog allows."""
        return [
            velocity if age <= watchdog_steps else (0.0, 0.0)
            for velocity, age in zip(self.velocities, self.age, strict=True)
        ]
