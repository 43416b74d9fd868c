"""What `import jaxmocap as jm` offers, with parameters, is what `public_api.txt` lists.

`JAXMOCAP_RENEW_API=1 python -m pytest -n 0 tests/test_public_api.py` writes the list anew.
"""

import importlib
import inspect
import os
import pkgutil
from pathlib import Path

import jaxmocap
from jaxmocap import _public

LIST = Path(__file__).with_name("public_api.txt")
RENEW = "JAXMOCAP_RENEW_API"


def described(name: str, value: object) -> str:
    """Kind, name and parameters, such as `function export(motion, path, *, units, up)`."""
    kind = "class" if inspect.isclass(value) else "function" if callable(value) else type(value).__name__
    if inspect.isclass(value) and issubclass(value, Exception):
        return f"exception {name}"
    shown = []
    for parameter in inspect.signature(value).parameters.values() if callable(value) else ():
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in shown:
            shown.append("*")
        stars = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
        optional = "" if parameter.default is parameter.empty else "="
        shown.append(f"{stars}{parameter.name}{optional}")
    return f"{kind} {name}({', '.join(shown)})"


def test_the_public_names_are_the_listed_ones():
    names = {
        name: value for name, value in vars(_public).items() if not name.startswith("_") and not inspect.ismodule(value)
    }
    names |= {"InputError": jaxmocap.InputError, "configure": jaxmocap.configure}
    lines = [described(name, names[name]) for name in sorted(names)]
    if os.environ.get(RENEW):
        LIST.write_text("\n".join(lines) + "\n")
    kept = LIST.read_text().splitlines()
    gone, new = [line for line in kept if line not in lines], [line for line in lines if line not in kept]
    assert lines == kept, (
        f"the public interface is not what {LIST.name} lists.\nNo longer there: {gone}\nNew: {new}\nIf that is meant, "
        f"say so in CHANGELOG.md and write the list anew: {RENEW}=1 python -m pytest -n 0 tests/{Path(__file__).name}"
    )


def test_every_public_name_is_itself_whatever_packages_are_imported():
    """`jaxmocap.scan` and `jaxmocap.track` are packages too, and importing those must not hide the functions."""
    for package in pkgutil.iter_modules(jaxmocap.__path__, "jaxmocap."):
        importlib.import_module(package.name)
    public = {n: value for n, value in vars(_public).items() if not n.startswith("_") and not inspect.ismodule(value)}
    assert {"scan", "track"} <= public.keys()
    assert [name for name, value in public.items() if getattr(jaxmocap, name) is not value] == []
