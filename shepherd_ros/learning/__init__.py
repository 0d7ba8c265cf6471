"""Training of policies: PPO in the simulator, cloning from bags, DAgger with a teacher."""
