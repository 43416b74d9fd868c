"""The command line, `jaxmocap` or `python -m jaxmocap`. JAX is imported by the commands, not here."""

import sys

from ._cli import run


def main() -> None:
    """Run the command line and exit with its code."""
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
