"""Learning to herd: from the simulator by PPO, from bags and from a teacher by imitation."""
