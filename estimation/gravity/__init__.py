"""Direction of gravity in base axes: its estimate, and where models and recordings take it."""
