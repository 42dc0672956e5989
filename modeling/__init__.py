"""Symbolic wrench models of a wrist force sensor: kinematics, rigid tool, effects, dynamics, code generation."""
