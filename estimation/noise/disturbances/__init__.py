"""Recording-specific disturbances: drift, transient events and tones."""
