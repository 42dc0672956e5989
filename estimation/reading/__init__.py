"""Reading: what robots write, in any of their formats, brought onto one clock as a recording, with a reading report."""
