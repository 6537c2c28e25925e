"""The command `erosion`, also as `python -m erosion`."""

import sys

from erosion.interrupts import between_imports


def main() -> None:
    """Run the command line and exit."""
    with between_imports():
        try:
            from erosion.cli import main as command_line  # half a second
        except KeyboardInterrupt:
            print("erosion: interrupted", file=sys.stderr)
            sys.exit(130)
        command_line()


if __name__ == "__main__":
    main()
