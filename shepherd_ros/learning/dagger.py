"""
DAgger (Ross, Gordon and Bagnell 2011): a teacher labels the states that the learner visits.

The teacher sees the true state, the learner its lidar.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

from shepherd_ros.config import ConfigError
from shepherd_ros.controllers.composite import HOME, WORD
from shepherd_ros.controllers.policy_controller import sample_noise
from shepherd_ros.learning.clone import CloneLearner, Examples
from shepherd_ros.learning.dagger_bags import DaggerBags
from shepherd_ros.learning.dagger_config import DaggerConfig
from shepherd_ros.learning.group import WorldGroup
from shepherd_ros.learning.run_folder import RunFolder
from shepherd_ros.learning.teachers import make_teacher
from shepherd_ros.learning.training_loop import TrainingLoop
from shepherd_ros.learning.validation import validate
from shepherd_ros.policy import inference
from shepherd_ros.policy.network import fast_dtype
from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.flocking import model_of
from shepherd_ros.sim.observation import rotate_by_ray
from shepherd_ros.sim.rollout import Moment
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor


class LabelledWorlds:
    """A group of worlds in which a learner acts and a teacher labels the states."""

    def __init__(
        self,
        config: DaggerConfig,
        policy: Policy,
        index: int,
        dtype: torch.dtype,
        again: bool = False,
    ) -> None:
        """
        Create the worlds and start their first episode, the shorter the lower the index.

        again: they are those of a resumed run, whose bags are written once more.
        """
        self.config, self.policy, self.dtype = config, policy, dtype
        self.timing, lidar = policy.config.timing(config.task.dt), policy.config.lidar
        self.group = WorldGroup(
            config.task, index, config.worlds, config.seed, lidar, count=bool(config.bag_folder)
        )
        self.full = config.task.episode_steps
        self.again = again
        self._begin(max(self.full * (index + 1) // config.groups, 1))

    def _begin(self, steps: int) -> None:
        """Start an episode with new memories."""
        self.group.begin(steps)
        self.bags = DaggerBags(self.config.bag_folder, self.again)
        self._begin_memories()

    def _begin_memories(self) -> None:
        """Create the teachers of the group's world, with new memories."""
        moment = self.group.moment
        state, world = moment.state, moment.config.world
        name = self.config.teacher_of(model_of(world.flock).name)
        self.teacher = make_teacher(name, world, self.config.teacher_goal_max)
        self.taught = self.teacher.begin(state)
        if self.policy.config.network.modes == 2 and HOME not in self.taught:
            raise ConfigError(
                f'teacher is {name!r}: expected {WORD}, as a policy with two modes '
                'learns which of them it is; or leave modes at 1'
            )
        worlds, team = state.shepherd_mask.shape
        self.learned = inference.begin(self.policy, self.timing, (worlds,), team, self.dtype)

    def _command(self, moment: Moment) -> Tensor:
        """Return the learner's commands, (B, H, 2) m/s: by samples, if its policy acts so."""
        state, std = moment.state, self.policy.config.sample_std
        team = state.shepherds.shape[-2]
        command, self.learned = inference.act(
            self.policy,
            self.timing,
            lambda: moment.ranges,
            state.shepherd_mask,
            self.learned,
            moment.config.world.shepherd_speed,
            (lambda: sample_noise(state.seed, state.step, team)) if std else None,
            std=std,
        )
        return command

    def run(self, steps: int, teacher_drives: bool, examples: Examples) -> None:
        """Run for some steps and add examples, of steps in which the learner decides."""
        example_due = False
        for t in range(steps):
            moment = self.group.moment
            decides = bool((self.learned['count'] % self.timing.action_repeat == 0).all())
            label, self.taught = self.teacher.act(moment.state, self.taught)
            command = self._command(moment)
            example_due |= t % self.config.example_interval == 0
            if example_due and decides:
                example_due = False
                self._add(examples, moment.state, label)
            executed = label if teacher_drives else command
            self.bags.add(self.group, executed, label)
            self.group.step(executed)
            if self.group.left <= 0:
                self.close()
                self._begin(self.full)

    def _add(self, examples: Examples, state: WorldState, label: Tensor) -> None:
        """Add the examples of a step, in which the learner has decided."""
        present = state.shepherd_mask
        frames = self.timing.frames.select(self.learned['history'][present])
        first = self.learned['first'][present]
        target = rotate_by_ray(label[present], -first, frames.shape[-1])
        home = self.taught.get(HOME, torch.zeros_like(state.step, dtype=torch.bool))
        weight = state.team_size.float() ** -self.config.example_team_exponent
        hold, weight = (x[:, None].expand_as(present)[present] for x in (home, weight))
        examples.add(frames, first, target, hold, weight)

    def close(self) -> None:
        """Finish the bags of the episode."""
        self.bags.close(self.group.moment)

    def state_dict(self) -> dict[str, Any]:
        """Return the episode and the memories of its controllers."""
        memories = {'taught': self.taught, 'learned': self.learned}
        return {'group': self.group.state_dict(), 'memories': memories}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state of state_dict(); the interrupted episode has no bag."""
        self.group.load_state_dict(state['group'])
        self.bags = DaggerBags('')
        self._begin_memories()
        for name, memory in state['memories'].items():
            setattr(self, name, memory)


class DaggerTrainer:
    """Worlds in which a learner acts, and the examples of the teacher in them."""

    def __init__(self, policy: Policy, config: DaggerConfig, again: bool) -> None:
        """Start all worlds; again: the run is a resumed one."""
        self.policy, self.config, self.eval_freq = policy, config, config.eval_freq
        self.dtype = fast_dtype()
        self.learner = CloneLearner(deepcopy(policy), config.clone, config.seed)
        self.worlds = [
            LabelledWorlds(config, policy, i, self.dtype, again) for i in range(config.groups)
        ]
        self.examples = Examples(policy, config.buffer_size, self.dtype)
        self.progress = {'updates': 0, 'samples': 0, 'examples': 0}

    def share(self) -> float:
        """Return the fraction of the rounds that is done."""
        return self.progress['updates'] / self.config.rounds

    def averaged(self) -> Policy:
        """Return the policy that acts, which is the running mean."""
        return self.policy

    def update(self, stopping: Callable[[], bool]) -> dict[str, float]:
        """Collect examples and train for a round; return its loss."""
        config, done = self.config, self.progress['updates']
        for i, worlds in enumerate(self.worlds):
            teacher_drives = done < config.teacher_rounds or i < config.teacher_groups
            worlds.run(config.steps_per_round, teacher_drives, self.examples)
        self.learner.scale_learning_rate(1 - 0.95 * self.share())
        loss = self.learner.learn(self.examples)
        self.learner.averaged(self.policy)
        samples = (done + 1) * config.clone.updates_per_round * config.clone.batch_size
        self.progress = {'updates': done + 1, 'samples': samples, 'examples': len(self.examples)}
        return {'loss': loss}

    def evaluate(self, policy: Policy) -> dict[str, float]:
        """Return the results of a policy on fixed starts."""
        return validate(policy, self.config.task, self.config.evaluation, self.dtype)

    def state_dict(self) -> dict[str, Any]:
        """Return the state of the training."""
        return {
            'cloner': self.learner.state_dict(),
            'worlds': [worlds.state_dict() for worlds in self.worlds],
            'examples': self.examples.state_dict(),
            'progress': dict(self.progress),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that state_dict() returned."""
        self.learner.load_state_dict(state['cloner'])
        self.learner.averaged(self.policy)
        for worlds, part in zip(self.worlds, state['worlds'], strict=True):
            worlds.load_state_dict(part)
        self.examples.load_state_dict(state['examples'])
        self.progress = dict(state['progress'])


def train_dagger(
    policy: Policy,
    config: DaggerConfig,
    run: RunFolder,
    on_line: Callable[[dict[str, Any]], None] = lambda line: None,
) -> Policy:
    """
    Train for all rounds; return the policy, which is changed in place.

    The policy that acts, is evaluated and is kept is a running mean of the trained weights.
    """
    trainer = DaggerTrainer(policy, config, run.resumes)
    TrainingLoop(run, trainer, on_line).run_to_end()
    for worlds in trainer.worlds:
        worlds.close()
    return policy
