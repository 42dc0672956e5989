"""Plot of an exciting trajectory."""
