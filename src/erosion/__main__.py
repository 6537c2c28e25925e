"""The command `erosion`, also as `python -m erosion`."""

import signal

from erosion.interrupts import stop_at_once


def main() -> None:
    """Run the command line and exit."""
    # A shell's background jobs ignore it.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, stop_at_once)
    from erosion.cli import main as command_line  # half a second

    command_line()


if __name__ == "__main__":
    main()
