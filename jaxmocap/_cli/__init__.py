"""The command line: one module per verb; `run` parses, calls the verb and turns what happened into an exit code."""

from ._run import run as run
