"""Many impacts: one integrator for one impact, compiled for many at a time. README.md leads through it."""
