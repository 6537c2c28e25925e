"""The command line: arguments to the public API to printed text.

Verbs that share much share a module; JAX loads only when a verb computes. Bad input is one line on stderr and
exit status 2, a failed solve exit status 1, never a traceback.
"""

import contextlib
import gc
import logging
import os
import sys
from collections.abc import Sequence
from typing import Any

import cyclopts

from erosion.cli.calibrate import advise, calibrate
from erosion.cli.errors import InputError, explain, printable, sentence, spell_out
from erosion.cli.export import export
from erosion.cli.lists import exercise, explore, materials, models, report, verify
from erosion.cli.map import map_
from erosion.cli.options import OPTIONS, Help
from erosion.cli.posterior import posterior, predict
from erosion.cli.run import compare, optimum, run
from erosion.cli.sweep import stream, sweep
from erosion.extras import MissingExtraError
from erosion.interrupts import INTERRUPTED
from erosion.output import briefly
from erosion.version import __version__

_ALLOCATIONS = 20_000  # between two looks for garbage, instead of 700
_NARROWEST, _WIDEST = 40, 1000  # characters of a line that help and tables are laid out for

app = cyclopts.App(
    name="erosion",
    help="How a rigid particle cuts a ductile surface, and at which angle it removes most.",
    help_format="plaintext",
    help_formatter=Help(),
    group_parameters=OPTIONS,
    group_commands=OPTIONS,
    version=__version__,
    suppress_keyboard_interrupt=False,  # what an interrupted verb says is to be read
    help_epilogue="Without a case file: Table 1 of the scenario, quartz sand on aluminium.",
)
_VERBS = {
    "Compute": (run, optimum, compare, sweep, stream),
    "Fit": (calibrate, posterior, predict, advise),
    "CFD": (map_, export),
    "Teach": (report, exercise, explore),
    "Check": (verify, models, materials),
}
_WITHOUT_EPILOGUE = (predict, map_, verify, models, materials)  # which say it themselves, or have no case
for at, (title, verbs) in enumerate(_VERBS.items()):
    group = cyclopts.Group(title, sort_key=at)
    for place, verb in enumerate(verbs):
        more = {"help_epilogue": ""} if verb in _WITHOUT_EPILOGUE else {}
        app.command(verb, name=verb.__name__.rstrip("_"), group=group, sort_key=place, **more)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
    # Modules and traced programs, hundreds of thousands of objects, live as long as the process does:
    # to look for garbage among them as often as is usual, and once more at the exit, takes half a second.
    gc.set_threshold(_ALLOCATIONS)
    # Where it has no place for its settings matplotlib says so in two lines, but needs none.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    spell_out()
    _have_room()
    status = exit_status(sys.argv[1:] if arguments is None else arguments)
    if status == INTERRUPTED:
        # Python would wait for threads that still compute, and end with SIGINT where it came while a text was executed.
        os._exit(status)
    gc.freeze()
    sys.exit(status)


def _have_room() -> None:
    """Whatever COLUMNS or a terminal says, lines have room for words: without any, rich shows nothing or never ends."""
    said = os.environ.pop("COLUMNS", "")
    if said.isdecimal() and float(said):
        os.environ["COLUMNS"] = str(int(min(max(float(said), _NARROWEST), _WIDEST)))
        return
    for handle in (0, 1, 2):  # as rich looks
        with contextlib.suppress(OSError):
            if 0 < os.get_terminal_size(handle).columns < _NARROWEST:
                os.environ["COLUMNS"] = str(_NARROWEST)


def exit_status(arguments: Sequence[str]) -> int:
    """Run a command line, say in one sentence what is wrong, and give the exit status."""
    # Read when equinox is imported. With its error checks (host callbacks) in a program, JAX
    # would not keep the compiled program for the next start; every verb checks outcomes itself.
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    try:
        words = [_text(argument) for argument in arguments]
        moment = os.environ.get("SOURCE_DATE_EPOCH", "")  # numpy reads it, and matplotlib
        if moment and not moment.isdecimal():
            raise InputError(
                f"The environment variable SOURCE_DATE_EPOCH must be whole seconds, but is {briefly(moment)}."
            )
        app(words, exit_on_error=False, print_error=False, result_action="return_value")
        if sys.stdout is not None:  # closed by the shell: `erosion run >&-`
            sys.stdout.flush()
    except cyclopts.CycloptsError as error:
        return _say(2, explain(error))
    except (InputError, MissingExtraError) as error:
        return _say(2, str(error))
    except BrokenPipeError:
        # The reader has gone (`erosion models | head -1`): say nothing, and let Python close in peace.
        sys.stdout = None
        return 0
    except KeyboardInterrupt as error:
        return _say(INTERRUPTED, str(error) or "interrupted")
    except SystemExit as error:
        # Rich ends the program so where the reader of the help has gone.
        if isinstance(error.__context__, BrokenPipeError):
            sys.stdout = None
            return 0
        return _say(1, f"A model's own code ended the program, with sys.exit({error.code!r}).")
    except MemoryError:
        return _say(1, "There is not enough memory for this.")
    # Anything below comes from the computation itself; a person gets the sentence.
    except (ArithmeticError, ImportError, OSError, RuntimeError) as error:
        _let_go(sys.stdout)
        return _say(1, sentence(error))
    # A plug-in's own code may raise anything, anywhere in a computation.
    except Exception as error:  # noqa: BLE001
        return _say(1, f"{type(error).__name__}: {error}")
    return 0


def _text(argument: str) -> str:
    """What is typed, where it is text: tables, pages and case files hold names, and none of them holds other bytes.

    Raises:
        InputError: for bytes that are no text, as of a file from a system of another encoding.
    """
    try:
        argument.encode()
    except UnicodeEncodeError as error:
        name = os.fsencode(argument).decode("ascii", "backslashreplace")
        encoding = sys.getfilesystemencoding().upper()
        way = "rename the file or the folder" if encoding == "UTF-8" else "set the environment variable PYTHONUTF8=1"
        raise InputError(f"The argument {name} is not text in {encoding}: {way}.") from error
    return argument


def _let_go(stream: Any) -> None:
    """Where an output takes no more, Python would try it again at its end, with a status of its own."""
    if stream is None:
        return
    try:
        stream.flush()
    except OSError:
        # What is left of it goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _say(status: int, message: str) -> int:
    with contextlib.suppress(OSError):  # there may be no place to say it
        if sys.stderr is not None:
            print("erosion:", printable(" ".join(message.split())), file=sys.stderr, flush=True)
    _let_go(sys.stderr)
    return status
