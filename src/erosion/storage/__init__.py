"""Results in files, and how a file says what it is a result of."""
