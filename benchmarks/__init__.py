"""Speed and accuracy of the library on fixed problems: python -m benchmarks."""
