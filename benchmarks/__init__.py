"""Speed and memory of the kernel beside its peers, at the same verified accuracy: `make bench`."""
