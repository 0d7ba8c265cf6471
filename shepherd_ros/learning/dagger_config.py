"""The configuration of DAgger: teachers, worlds, and the amounts of collecting and training."""

from __future__ import annotations

from dataclasses import dataclass

from shepherd_ros.config import Config, option, part
from shepherd_ros.experiments.methods import full_name
from shepherd_ros.learning.clone import CloneConfig
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.validation import EvaluationConfig


@dataclass(frozen=True)
class DaggerConfig(Config):
    """A whole run; all are choices."""

    seed: int = option(0, 'seed of weights, worlds and order', low=0)
    teacher: str = option(
        'drover',
        'controller that is imitated; a policy as policy:CHECKPOINT, two as composite:DRIVE,HOLD',
    )
    reynolds_teacher: str = option('drover', 'the same for a Reynolds flock')
    teacher_goal_max: float = option(0.0, 'widest goal that a policy sees [m]; 0: any', low=0.0)
    rounds: int = option(60, 'rounds of driving and learning', low=1)
    teacher_rounds: int = option(6, 'first rounds, in which the teacher drives', low=0)
    steps_per_round: int = option(40, 'steps of a round', low=1)
    example_interval: int = option(4, 'steps from one example to the next', low=1)
    groups: int = option(12, 'groups of worlds that share what is drawn', low=1)
    worlds: int = option(8, 'worlds of a group', low=1)
    teacher_groups: int = option(1, 'groups that the teacher always drives', low=0)
    example_team_exponent: float = option(0.0, 'that of M counts M to minus this', low=0.0)
    buffer_size: int = option(200_000, 'examples that are kept, the newest', low=1)
    eval_freq: int = option(10, 'rounds from one evaluation to the next', low=1)
    bag_folder: str = option('', 'folder for bags of all that is driven, with labels; empty: none')
    evaluation: EvaluationConfig = part(EvaluationConfig)
    task: TaskConfig = part(TaskConfig)
    clone: CloneConfig = part(CloneConfig)

    def __post_init__(self) -> None:
        """Check each field and the names of the teachers."""
        super().__post_init__()
        for name in (self.teacher, self.reynolds_teacher):
            full_name(name)

    def teacher_of(self, flock: str) -> str:
        """Return the teacher for a flock model."""
        return str(getattr(self, f'{flock}_teacher', self.teacher))
