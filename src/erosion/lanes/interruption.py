"""What generated code does so that a loop that never ends can be interrupted.

The code computes without Python's lock. A signal's handler (Ctrl-C) runs only in the main thread, and only where that
thread asks for it. So the code counts the rounds of its loops, and after many of them it asks. In the other threads
it looks at a word in memory instead, which the main thread sets.
"""

_ROUNDS = 2**14  # some hundredths of a second

PYTHONS = ("PyEval_SaveThread", "PyEval_RestoreThread", "PyErr_CheckSignals")
"""Functions of Python that the code calls."""

INTERRUPTED = """declare ptr @PyEval_SaveThread()
declare void @PyEval_RestoreThread(ptr)
declare i32 @PyErr_CheckSignals()
define private i1 @interrupted(ptr %rounds, ptr %stop, ptr %thread) nounwind {
  store i64 0, ptr %rounds
  %alone = icmp eq ptr %stop, null
  br i1 %alone, label %signals, label %told
told:
  %word = load volatile i64, ptr %stop
  %stopped = icmp ne i64 %word, 0
  ret i1 %stopped
signals:
  call void @PyEval_RestoreThread(ptr %thread)
  %status = call i32 @PyErr_CheckSignals()
  %same = call ptr @PyEval_SaveThread()
  %came = icmp ne i32 %status, 0
  ret i1 %came
}"""
"""Whether to end: *stop is not 0, or, where `stop` is null, a handler has raised. Rounds are counted from 0 again."""


def look_for_a_stop(again: str) -> list[str]:
    """The end of a round: it goes to the label `again`, or, where the function is to stop, to `exit`."""
    return [
        f"  %before.{again} = load i64, ptr %rounds",
        f"  %rounds.{again} = add i64 %before.{again}, 1",
        f"  store i64 %rounds.{again}, ptr %rounds",
        f"  %many.{again} = icmp ugt i64 %rounds.{again}, {_ROUNDS}",
        f"  br i1 %many.{again}, label %look.{again}, label %{again}",
        f"look.{again}:",
        f"  %stopped.{again} = call i1 @interrupted(ptr %rounds, ptr %stop, ptr %thread)",
        f"  br i1 %stopped.{again}, label %exit, label %{again}",
    ]
