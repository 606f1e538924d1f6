"""Exit statuses of the commands; 0 is done and 2 wrong usage, as argparse has it."""

FAILURE = 1
"""The input, a setting or the output cannot be used, or a part of the work failed."""
PIPE_CLOSED = 141
"""Whoever read the output went away, as ``head`` does; what shells say of it (128 + SIGPIPE)."""
INTERRUPTED = 130
"""Ctrl-C; what was done until then is kept where the command says so."""
