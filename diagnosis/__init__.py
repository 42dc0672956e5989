"""Model diagnosis: fit, screen, select, validate, verdict; and the discriminating experiment to run next."""
