"""What tests share: rigs, recordings, places of data, writers of logs, emitted code."""
