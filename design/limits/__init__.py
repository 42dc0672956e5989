"""Joint and workspace limits: their use by a trajectory at every instant, and random feasible trajectories."""
