"""What is reported of reading a recording: steps, clocks, and curves for a picture."""
