"""Training of policies: PPO in the simulator, cloning from bags, DAgger with a teacher."""

__all__ = [
    'annealing',
    'clone',
    'dagger',
    'dagger_config',
    'distributed',
    'ppo',
    'ppo_rollout',
    'run_folder',
    'task',
    'train_bc',
    'train_ppo',
]
