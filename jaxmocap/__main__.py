"""The command line, `jaxmocap` or `python -m jaxmocap`. JAX is imported by the commands, not here."""

import os
import sys

from ._cli import run

READER_GONE = 141
"""Exit code where what reads the output has ended, such as `head`: as of a program that SIGPIPE ends."""


def main() -> None:
    """Run the command line and exit with its code."""
    try:
        code = run(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:
        if not _reader_gone():
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what Python still writes when it ends
        code = READER_GONE
    sys.exit(code)


def _reader_gone() -> bool:
    """Whether it is our own output that nobody reads, and not that of another process of ours."""
    try:
        print(flush=True)
    except BrokenPipeError:
        return True
    return False


if __name__ == "__main__":
    main()
