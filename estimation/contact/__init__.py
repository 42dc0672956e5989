"""What the environment does to the tool: its wrench, when, how sure, and sample by sample."""
