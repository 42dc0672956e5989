"""Evidence in the samples: which of several readings the tool's weight shows, and which channels are faulty."""
