"""`jaxmocap doctor`: is this installation sound?"""

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Group
from rich.table import Table

from ._arguments import Json
from ._output import progress, say, show

if TYPE_CHECKING:
    from jaxmocap.pipeline import Diagnosis

UNSOUND = 1


def doctor(
    test: Annotated[bool, tyro.conf.arg(help_behavior_hint="", help="Leave out the self-test.")] = True,
    warm: Annotated[
        bool, tyro.conf.arg(help_behavior_hint="", help="Also compile what tracking two films runs, for some minutes.")
    ] = False,
    json: Json = False,
) -> int:
    """Print versions, devices, caches, codecs and optional parts, and run a self-test of some seconds.

    Exits with 1 if something is wrong.
    """
    from jaxmocap.pipeline import doctor

    if test:
        say("self-test ... (about ten seconds; a minute the first time, when programs are compiled)")
    if warm:
        say("compiling what tracking runs ... (some minutes; the first film then need not)")
    with progress() as report:
        found = doctor(test=test, warm=warm, progress=report)
    show(asdict(found), lambda: _tables(found), json_wanted=json)
    return UNSOUND if found.problems else 0


def _tables(found: "Diagnosis") -> Group:
    from jaxmocap.pipeline import EXTRAS, WARMED

    rows = [(name, one) for name, one in found.versions.items()]
    system = found.system
    memory = "" if system["memory_gb"] is None else f", {system['memory_gb']} GB memory"
    rows += [("system", f"{system['platform']}, {system['cores']} cores{memory}")]
    for device in found.devices:
        limit = "" if device["memory_gb"] is None else f", {device['memory_gb']} GB"
        rows.append(("device", f"{device['name']} ({device['kind']}{limit})"))
    cache = found.cache
    kept = f"{cache['folder']}: {cache['files']} files, {cache['megabytes']} MB"
    rows.append(("compiled programs", kept if cache["folder"] else "not kept"))
    rows.append(("free disk", f"{system['free_disk_gb']} GB"))
    rows.append(("reads", ", ".join(label for label, there in found.decoders.items() if there)))
    rows.append(("writes", "H.264" if found.encodes else "nothing"))
    for name, (package, use) in EXTRAS.items():
        there = found.extras[name]
        missing = f"not installed, for {use}: pip install 'jaxmocap[{name}]'"
        rows.append((f"extra {name}", f"{package} {there}, for {use}" if there else missing))
    table = Table(title="jaxmocap doctor", title_justify="left", show_header=False)
    for name, text in rows:
        table.add_row(name, text)
    if found.warmed is not None:
        table.add_row("compiled ahead", f"in {found.warmed:.0f} s: {WARMED}")
    parts: list[Table | str] = [table]
    if found.tests:
        steps = Table(title="Self-test", title_justify="left")
        for column in ("Step", "", "What came out", "Seconds"):
            steps.add_column(column, justify="right" if column == "Seconds" else "left")
        for one in found.tests:
            steps.add_row(one.name, "ok" if one.passed else "FAILED", one.said, f"{one.seconds:.1f}")
        parts.append(steps)
    return Group(*parts, *(f"Problem: {problem}." for problem in found.problems), _verdict(found))


def _verdict(found: "Diagnosis") -> str:
    if found.problems:
        return "Something is wrong: see the problems above."
    return "All is well." if found.tests else "Nothing is wrong; the self-test was left out."
