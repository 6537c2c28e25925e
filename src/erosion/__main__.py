"""`python -m erosion`."""

from erosion.cli import main

main()
