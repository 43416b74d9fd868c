"""Weights from packages, bundles and folders, by hash; without a network."""

import hashlib
import io
import subprocess
import tarfile
import zipfile
from dataclasses import replace

import pytest

from jaxmocap._results import InputError
from jaxmocap.detection import CARDS, _weights, get_weights, open_model, require_runner
from jaxmocap.detection._cards import WeightFile

FILES = {"person.bin": b"finds people", "heavy.bin": b"heavy landmarks", "full.bin": b"full landmarks"}
BUNDLED = {"pose_detector.tflite": b"FINDS PEOPLE", "pose_landmarks_detector.tflite": b"FULL LANDMARKS"}


def listed(name: str) -> tuple[WeightFile, ...]:
    return (WeightFile(name, hashlib.sha256(FILES[name]).hexdigest(), len(FILES[name])),)


@pytest.fixture(autouse=True)
def cards(monkeypatch, tmp_path):
    """The cards with small files, and a cache of this test's own."""
    for name in CARDS:
        networks = {"person": listed("person.bin"), "landmarks": listed(f"{name}.bin")}
        monkeypatch.setitem(CARDS, name, replace(CARDS[name], networks=networks))
    monkeypatch.setattr(_weights, "cache_folder", lambda name: tmp_path / "cache" / name)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: pytest.fail("nothing is to be downloaded"))


def pack(path, contents):
    if path.suffix == ".tgz":
        with tarfile.open(path, "w:gz") as archive:
            for name, content in contents.items():
                member = tarfile.TarInfo(f"package/{name}")
                member.size = len(content)
                archive.addfile(member, io.BytesIO(content))
    elif path.suffix:
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in contents.items():
                archive.writestr(f"deep/inside/{name}", content)
    else:
        (path / "sub").mkdir(parents=True)
        for name, content in contents.items():
            (path / "sub" / name).write_bytes(content)
    return path


@pytest.mark.parametrize("form", ["weights.tgz", "weights.whl", "folder"])
def test_given_weights_are_checked_kept_and_found_again(tmp_path, form):
    said = []
    weights = get_weights(None, pack(tmp_path / form, FILES), said.append)
    assert (weights.name, weights.networks) == ("heavy", {"person": b"finds people", "landmarks": b"heavy landmarks"})
    assert weights.hashes["landmarks"] == hashlib.sha256(b"heavy landmarks").hexdigest()
    assert said == [
        f"Weights of BlazePose GHUM heavy from {tmp_path / form}, licence Apache-2.0; kept in "
        f"{tmp_path / 'cache' / 'weights'}."
    ]
    assert get_weights("heavy") == weights


def test_the_better_model_that_is_there_is_taken(tmp_path):
    path = pack(tmp_path / "weights.whl", {name: FILES[name] for name in ("person.bin", "full.bin")})
    assert get_weights(None, path).name == "full"
    with pytest.raises(InputError, match=r"weights .*whl do not hold BlazePose GHUM heavy: found person.bin, expected"):
        get_weights("heavy", path)


def test_a_bundle_whose_hashes_no_card_has_is_told_by_names_and_sizes_and_not_kept(tmp_path, monkeypatch):
    said = []
    weights = get_weights("full", pack(tmp_path / "pose.task", BUNDLED), said.append)
    assert weights.networks == {"person": b"FINDS PEOPLE", "landmarks": b"FULL LANDMARKS"}
    assert said[0].endswith("no card has their SHA-256, so they are not kept.")
    assert not (tmp_path / "cache").exists()
    long = BUNDLED | {"pose_landmarks_detector.tflite": bytes(100)}
    with pytest.raises(
        InputError, match=r"do not hold BlazePose GHUM heavy: found pose_detector.tflite, pose_landmarks"
    ):
        get_weights("heavy", pack(tmp_path / "other.task", long))


def test_weights_that_are_not_those_of_the_card_are_sentences(tmp_path):
    changed = pack(tmp_path / "changed.tgz", FILES | {"heavy.bin": b"heavy landmarkS"})
    with pytest.raises(
        InputError, match=r"heavy.bin in .*changed.tgz is not the file of BlazePose GHUM heavy: its SHA-"
    ):
        get_weights("heavy", changed)
    with pytest.raises(InputError, match=r"weights .*nowhere are no model: not there; expected a folder, a package"):
        get_weights("heavy", tmp_path / "nowhere")
    text = tmp_path / "text.tflite"
    text.write_text("no archive")
    with pytest.raises(InputError, match="are no model: neither a folder nor an archive; expected"):
        get_weights("heavy", text)
    cut = pack(tmp_path / "cut.tgz", FILES)
    cut.write_bytes(cut.read_bytes()[:150])
    with pytest.raises(InputError, match=r"weights .*cut.tgz"):
        get_weights("heavy", cut)
    flipped = tmp_path / "flipped.whl"
    with zipfile.ZipFile(flipped, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("heavy.bin", " ".join(map(str, range(5000))))
    content = bytearray(flipped.read_bytes())
    content[200:220] = bytes(20)
    flipped.write_bytes(content)
    with pytest.raises(InputError, match=r"weights .*flipped.whl cannot be read"):
        get_weights("heavy", flipped)
    assert not (tmp_path / "cache").exists()


def test_a_damaged_file_in_the_cache_is_not_used(tmp_path, monkeypatch):
    get_weights("heavy", pack(tmp_path / "folder", FILES))
    (tmp_path / "cache" / "weights" / "heavy.bin").write_bytes(b"heavy landmark?")
    monkeypatch.setattr(_weights.shutil, "which", lambda name: None)
    with pytest.raises(
        InputError, match=r"not in .*weights and could not be downloaded: npm is not installed; give a pa"
    ):
        get_weights("heavy")


def test_packages_are_downloaded_by_the_client_that_is_there_and_never_installed(tmp_path, monkeypatch):
    commands = []

    def download(command, **_):
        commands.append(command)
        if "pack" in command:
            return subprocess.CompletedProcess(command, 1, "", "npm error code ENOTFOUND\nnpm error network")
        pack(tmp_path / "given.whl", FILES)
        folder = command[command.index("--dest") + 1]
        (tmp_path / "given.whl").rename(f"{folder}/mediapipe.whl")
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(_weights.shutil, "which", lambda name: f"/bin/{name}")
    monkeypatch.setattr(subprocess, "run", download)
    said = []
    assert get_weights(None, say=said.append).name == "full"
    assert [command[1] for command in commands] == ["pack", "pack", "-m"]
    assert "--ignore-scripts" in commands[0]
    assert commands[0][-1] == "@mediapipe/pose@0.5.1675469404"
    assert "download" in commands[2]
    assert "--no-deps" in commands[2]
    assert "PyPI's mediapipe 0.10.21, licence Apache-2.0" in said[-1]


def test_without_a_network_the_clients_words_are_handed_on(monkeypatch):
    failed = subprocess.CompletedProcess([], 1, "", "WARNING: again\nERROR: Could not find mediapipe\n")
    monkeypatch.setattr(_weights.shutil, "which", lambda name: None)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(InputError) as refused:
        get_weights()
    assert str(refused.value).count("\n") == 0
    assert "npm is not installed; pip says: ERROR: Could not find mediapipe; give a package" in str(refused.value)


def test_a_missing_runner_is_a_sentence(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        InputError, match=r"needs the package ai-edge-litert, .*; run: pip install 'jaxmocap\[detect\]'"
    ):
        require_runner()


def test_a_file_that_holds_no_network_is_a_sentence(tmp_path):
    pytest.importorskip("ai_edge_litert", reason="the extra detect is not installed")
    weights = get_weights("heavy", pack(tmp_path / "folder", FILES))
    with pytest.raises(
        InputError, match="the person detector of BlazePose GHUM heavy is no network of TensorFlow Lite"
    ):
        open_model(weights)
