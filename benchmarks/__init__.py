"""Speed and memory of the engine beside its peers, at the same verified accuracy: `make bench`."""
