"""The command `erosion`, also as `python -m erosion`."""

import signal


def main() -> None:
    """Run the command line and exit."""
    # See `erosion.interrupts`. A shell's background jobs ignore it.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from erosion.cli import main as command_line  # 0.5 s, in which Ctrl-C ends the process

    command_line()


if __name__ == "__main__":
    main()
