"""Untrusted configurations and run folders: no code, no foreign files, no size attacks."""

import io
import sys
import time
import zipfile

import numpy as np
import pytest
import yaml

from evo_cpg.io.build import build_experiment
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import load_config
from evo_cpg.io.trust import LARGEST, VARIABLE, trusting
from evo_cpg.training.run_folder import RunFolder, RunFolderError
from tiny_run import CONFIG, REPOSITORY

CREATURE = """
name: lump
materials: {stuff: {density: 1000}}
bodies: [{name: lump, shape: {type: sphere, radius: 0.1}, material: stuff}]
light_sensors: [{body: lump}]
"""


@pytest.fixture(autouse=True)
def stranger(monkeypatch):
    """Remove the variable that trusts all configurations."""
    monkeypatch.delenv(VARIABLE)


@pytest.fixture
def theirs(tmp_path, monkeypatch):
    """Return a foreign folder, next to the working folder."""
    (tmp_path / "theirs").mkdir()
    (tmp_path / "mine").mkdir()
    (tmp_path / "secret.yaml").write_text(CREATURE)
    monkeypatch.chdir(tmp_path / "mine")
    return tmp_path / "theirs"


def written(folder, text, name="x.yaml"):
    (folder / name).write_text(text)
    return folder / name


def problem(path, *overrides):
    with pytest.raises(ConfigError) as caught:
        load_config(path, overrides)
    return str(caught.value)


@pytest.mark.parametrize("name", ["../secret.yaml", "/etc/passwd", "below/../../secret.yaml"])
def test_creature_outside_the_folder_is_not_read(theirs, name):
    path = written(theirs, f"name: x\ncreature: {name}\n")
    assert "creature.file" in problem(path) and "outside of the conf" in problem(path)


def test_link_to_the_outside_is_not_followed(theirs):
    (theirs / "creature.yaml").symlink_to(theirs.parent / "secret.yaml")
    path = written(theirs, "name: x\ncreature: creature.yaml\n")
    assert "outside of the configuration's folder" in problem(path)


def test_overrides_may_name_any_file(theirs):
    path = written(theirs, "name: x\ncreature: own.yaml\n")
    written(theirs, CREATURE.replace("lump", "clump"), "own.yaml")
    assert load_config(path).creature.name == "clump"
    lighter = "creature.materials.stuff.density=900"
    found = load_config(path, ["creature=../secret.yaml", lighter]).creature
    assert (found.name, found.materials["stuff"].density) == ("lump", 900)


def test_trusted_configuration_may_name_any_file(theirs):
    path = written(theirs, "name: x\ncreature: ../secret.yaml\n")
    with trusting():
        assert load_config(path).creature.name == "lump"
    assert "outside" in problem(path)


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("world.ground.floor.file", "world: {ground: {floor: {type: relief, file: ../a.csv}}}"),
        (
            "creature.bodies.0.shape.file",
            "creature: {name: y, bodies: [{name: a, shape: {type: mesh, file: ../a.stl}}]}",
        ),
    ],
)
def test_reliefs_and_meshes_outside_the_folder_are_not_read(theirs, key, text):
    (theirs.parent / "a.csv").write_text("0,0\n0,0\n")
    (theirs.parent / "a.stl").write_text("solid a\nendsolid a\n")
    path = written(theirs, f"name: x\n{text}\n")
    assert key in problem(path) and "outside" in problem(path)


MODULE = "open({!r}, 'w').close()\nraise RuntimeError\n"


@pytest.mark.parametrize("name", ["evil_task", "evil_package.task"])
def test_code_beside_an_untrusted_configuration_is_not_run(theirs, name):
    hint = theirs.parent / "was_run"
    if "." in name:
        (theirs / "evil_package").mkdir()
        written(theirs / "evil_package", MODULE.format(str(hint)), "__init__.py")
        written(theirs / "evil_package", "", "task.py")
    else:
        written(theirs, MODULE.format(str(hint)), "evil_task.py")
    swimmer = REPOSITORY / "configs" / "creatures" / "swimmer10.yaml"
    written(theirs, swimmer.read_text(), "own.yaml")
    path = written(theirs, f"name: x\ncreature: own.yaml\ntask: {{type: '{name}:Task'}}\n")
    before = list(sys.path)
    with pytest.raises(ConfigError, match="code is run only from the working folder") as caught:
        build_experiment(load_config(path), path, [theirs])
    assert "task.type" in str(caught.value)
    assert not hint.exists() and str(theirs) not in sys.path
    try:
        with trusting(), pytest.raises(ConfigError, match="RuntimeError"):
            build_experiment(load_config(path), path)
        assert hint.exists()
    finally:
        sys.path[:] = before
        for each in ("evil_task", "evil_package", "evil_package.task"):
            sys.modules.pop(each, None)


def aliases(depth, width):
    lines = ["a0: &a0 [lol]"]
    for i in range(depth):
        lines.append(f"a{i + 1}: &a{i + 1} [{', '.join([f'*a{i}'] * width)}]")
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (aliases(9, 10), "more than 500000 values"),
        ("a: " + "[" * 500 + "]" * 500, "nested more than 50 levels deep"),
        ("a: " + "{b: " * 60 + "1" + "}" * 60, "nested more than 50 levels deep"),
        ("a: &a [*a]", "the alias *a is inside its own anchor"),
        ("a: &a {b: {<<: *a}}", "the alias *a is inside its own anchor"),
        ("a: !!python/object/apply:os.system ['true']", "could not determine a constructor"),
        ("a: [" + "0," * 600_000 + "]", "more than 500000 values"),
    ],
)
def test_yaml_of_unbounded_size_is_rejected_quickly(tmp_path, text, words):
    path = written(tmp_path, text)
    start = time.perf_counter()
    assert words in problem(path)
    assert time.perf_counter() - start < 5


def test_small_aliases_are_accepted(tmp_path):
    path = written(tmp_path, "a: &a [1, 2]\n" + "".join(f"b{i}: *a\n" for i in range(100)))
    assert "unknown key" in problem(path)


def test_too_large_file_is_not_read(tmp_path):
    path = tmp_path / "x.yaml"
    with path.open("wb") as file:
        file.truncate(LARGEST + 1)
    assert "cannot be read (32 MiB, more than the limit of 32 MiB)" in problem(path)


def test_array_with_a_too_large_header_is_rejected(tmp_path):
    (tmp_path / "a.npy").write_bytes(npy(np.zeros(8), shape=(10**6, 10**6)))
    path = written(
        tmp_path, "name: x\nworld: {ground: {floor: {type: relief, file: a.npy, spacing: 1}}}\n"
    )
    assert "a.npy: cannot be read" in problem(path)


def champion_of(folder, arrays, compression=zipfile.ZIP_STORED):
    """Create a run folder whose champion file contains some arrays."""
    run = RunFolder(folder / "run")
    config = yaml.safe_load(CONFIG.read_text()) | {"creature": yaml.safe_load(CREATURE)}
    run.create(yaml.safe_dump(config), {})
    with zipfile.ZipFile(run.champion, "w", compression) as file:
        for name, contents in arrays.items():
            file.writestr(f"{name}.npy", contents)
    return run


def npy(array, shape=None):
    contents = io.BytesIO()
    np.save(contents, array)
    if shape is None:
        return contents.getvalue()
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": shape}
    )
    return header.getvalue() + array.tobytes()


def pickled():
    contents = io.BytesIO()
    np.save(contents, np.array([{"a": 1}], object), allow_pickle=True)
    return contents.getvalue()


@pytest.mark.parametrize(
    ("genes", "compression", "words"),
    [
        (pickled(), zipfile.ZIP_STORED, "is damaged"),
        (npy(np.zeros(4), shape=(10**9, 10**9)), zipfile.ZIP_STORED, "is damaged"),
        (npy(np.zeros(10**7)), zipfile.ZIP_DEFLATED, "damaged.*more than the file holds"),
    ],
    ids=["pickle", "too large a header", "expands too far"],
)
def test_evil_genes_of_a_champion_are_not_read(tmp_path, genes, compression, words):
    run = champion_of(tmp_path, {"genes": genes}, compression)
    assert run.champion.stat().st_size < 10**6
    with pytest.raises(RunFolderError, match=words):
        run.load_champion()


def test_invalid_metadata_is_ignored(tmp_path):
    run = champion_of(tmp_path, {})
    run.meta.write_text("[" * 10**6)
    assert run.read_meta() == {}
    for text in ('{"devices": "many"}', '{"devices": 1000000000}', '{"config": 3}'):
        run.meta.write_text(text)
        assert run.read_meta() == {}
    run.meta.write_text('{"devices": 4}')
    assert run.read_meta() == {"devices": 4}
