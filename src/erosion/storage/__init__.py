"""Results in files, each with the identity of its result."""
