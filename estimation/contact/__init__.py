"""Contact of the tool with the environment: wrench with covariance, detection, location, and a real-time filter."""
