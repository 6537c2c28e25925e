"""Measurements that take too long for tests: speed against peers, ends on a dense grid, memory."""
