"""Picture of a reading: how a log became a recording."""
