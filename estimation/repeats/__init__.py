"""What the repeats of a motion say: averages, remainders, and the scatter of estimates."""
