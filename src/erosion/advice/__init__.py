"""Advice for an engineer: the nozzle angle that is good whichever model holds, and the erosion to expect there."""
