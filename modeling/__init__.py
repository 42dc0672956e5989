"""The physics, symbolic: kinematics, the tip body, effects, regressors and the code they become."""
