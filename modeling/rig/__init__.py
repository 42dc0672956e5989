"""Description of the rig: arm, limits, workspace and sensor, with the schema of its TOML file."""
