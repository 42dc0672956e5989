"""Reports of diagnoses, fits and comparisons, as self-contained HTML and as Markdown."""
