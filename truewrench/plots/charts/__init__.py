"""Charts: what a figure shows, without the library that draws it, and the two that do."""
