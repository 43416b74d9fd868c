"""Nothing in the package runs what a file says: no pickle, no eval, no shell."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted([*(ROOT / "jaxmocap").rglob("*.py"), *(ROOT / "benchmarks").glob("*.py")])
MODULES = {"pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"}
PICKLE_READER = ROOT / "jaxmocap" / "datasets" / "_array_pickle.py"
"""Of data sets that give pickles; its own tests show that it runs nothing."""
CALLS = {"eval", "exec", "compile", "__import__", "system", "popen"}


def offences(source: str) -> list[str]:
    """What a file does that could run foreign code."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            found += [f"line {node.lineno} imports {name}" for name in names if name.split(".")[0] in MODULES]
        if isinstance(node, ast.Call):
            name, owner = "", ""
            if isinstance(node.func, ast.Name):
                name = node.func.id
            elif isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.Name):
                name, owner = node.func.attr, node.func.value.id
            if name in CALLS and owner in ("", "os", "builtins"):
                found.append(f"line {node.lineno} calls {name}")
            for keyword in node.keywords:
                on = not (isinstance(keyword.value, ast.Constant) and keyword.value.value is False)
                if keyword.arg in ("shell", "allow_pickle") and on:
                    found.append(f"line {node.lineno} gives {keyword.arg}")
            if owner in ("np", "numpy") and name == "load" and "allow_pickle" not in {k.arg for k in node.keywords}:
                found.append(f"line {node.lineno} loads without allow_pickle=False")
        names = [node.attr] if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "yaml" else []
        if isinstance(node, ast.ImportFrom) and node.module == "yaml":
            names = [alias.name for alias in node.names]
        for name in names:
            if ("load" in name.lower() and "safe" not in name.lower()) or name.startswith("unsafe"):
                found.append(f"line {node.lineno} reads YAML with {name}, which is not a safe loader")
    return found


def test_no_file_runs_foreign_code():
    wrong = [(path.relative_to(ROOT), offence) for path in FILES for offence in offences(path.read_text())]
    reader = [offence for path, offence in wrong if ROOT / path == PICKLE_READER]
    assert len(wrong) == len(reader), wrong
    assert [words.split(" ", 2)[2] for words in reader] == ["imports pickle"]


def test_the_reader_of_pickles_finds_no_class_by_itself():
    tree = ast.parse(PICKLE_READER.read_text())
    used = {
        node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "pickle"
    }
    assert used == {"_Unpickler", "UnpicklingError", "BYTEARRAY8", "BINBYTES8"}
    (reader,) = (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef) and node.bases)
    assert [ast.unparse(base) for base in reader.bases] == ["pickle._Unpickler"]
    assert [node.name for node in reader.body if isinstance(node, ast.FunctionDef)] == ["find_class"]
    assert "super" not in ast.unparse(reader)


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from joblib import load",
        "eval(text)",
        "os.system(text)",
        "subprocess.run(text, shell=True)",
        "np.load(path)",
        "np.load(path, allow_pickle=True)",
        "yaml.load(text, yaml.SafeLoader)",
        "yaml.unsafe_load(text)",
        "yaml.parse(text, yaml.FullLoader)",
        "from yaml import CLoader",
    ],
)
def test_the_test_sees_it(source):
    assert offences(source)


def test_a_safe_loader_is_safe():
    assert not offences('yaml.parse(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))')
