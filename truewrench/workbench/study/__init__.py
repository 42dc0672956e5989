"""What the page shows and does: the study, in a process of its own."""
