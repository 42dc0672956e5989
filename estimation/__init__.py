"""From recordings to parameters: noise, fits, physical consistency and contact."""
