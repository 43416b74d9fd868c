"""The commands by stage, and the help that lists them so."""

import inspect
from collections.abc import Callable, Mapping

from rich.console import Console
from rich.table import Table

Groups = Mapping[str, Mapping[str, Callable[..., int]]]


def show_help(groups: Groups, description: str) -> None:
    """Print the commands by group, each with the first paragraph of what it says of itself."""
    console = Console(highlight=False)
    console.print("usage: jaxmocap COMMAND ...; jaxmocap COMMAND --help lists its options\n", markup=False)
    console.print(description, markup=False)
    for title, commands in groups.items():
        table = Table(box=None, show_header=False, padding=(0, 2, 0, 0), title=f"\n{title}", title_justify="left")
        table.add_column(width=max(len(name) for group in groups.values() for name in group), no_wrap=True)
        table.add_column()
        for name, command in commands.items():
            first = (inspect.getdoc(command) or "").partition("\n\n")[0]
            table.add_row(name, " ".join(first.split()))
        console.print(table)
