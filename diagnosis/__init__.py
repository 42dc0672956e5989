"""Where a model fails, which effect explains it, and which experiment would tell."""
