"""The identified tool in the formats of robot descriptions and controllers."""
