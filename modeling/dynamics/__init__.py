"""Dynamic stages of the chain: deflection, play and transfer function, over records and sample by sample."""
