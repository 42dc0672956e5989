"""Find what a force/torque model is missing, add it, and say what remains."""
