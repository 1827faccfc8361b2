"""Configurations that come with the program: names, summaries and copies."""

import filecmp
from pathlib import Path

import pytest

from evo_cpg.io import shipped as module
from evo_cpg.io.errors import ConfigError
from evo_cpg.io.load import load_config
from evo_cpg.io.shipped import copy_shipped, find_config, shipped, shipped_folder, shipped_names
from evo_cpg.io.trust import VARIABLE
from shipped_configs import some_configs
from tiny_run import REPOSITORY

CONFIGS = REPOSITORY / "configs"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Work in an empty folder, without trust."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(VARIABLE)


def test_a_checkout_uses_its_configs_folder():
    assert shipped_folder() == CONFIGS
    assert shipped_names() == sorted(path.stem for path in CONFIGS.glob("*.yaml"))


def test_an_installed_package_uses_only_its_own_configs(tmp_path, monkeypatch):
    package = tmp_path / "site-packages" / "evo_cpg"
    (package.parent / "configs").mkdir(parents=True)
    (package.parent / "configs" / "foreign.yaml").touch()
    monkeypatch.setattr(module, "_PACKAGE", package)
    assert shipped_folder() is None and shipped_names() == []
    (package / "configs").mkdir(parents=True)
    (package / "configs" / "ours.yaml").touch()
    assert shipped_names() == ["ours"]


@pytest.mark.parametrize("name", shipped_names())
def test_every_config_has_a_unique_summary(name):
    found = shipped(name)
    assert (found.name, found.path) == (name, CONFIGS / f"{name}.yaml")
    assert 20 < len(found.summary) < 190 and not found.summary.endswith(".")
    assert found.summary not in {
        shipped(other).summary for other in shipped_names() if other != name
    }
    assert found.study in ("", "Iwadate 2010", "Fukui 2003", "Sims 1994")


def test_summary_is_the_first_sentence_and_study_has_a_year(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "shipped_folder", lambda: tmp_path)
    (tmp_path / "a.yaml").write_text(
        "# Ten of them (Poe, Dickens and Melville 1951), of 1.5 m. They\n# swim.\n#\n# More 1999.\n"
    )
    (tmp_path / "b.yaml").write_text("name: b\n# Not at the head 2000\n")
    assert shipped("a")[3:] == (
        "Ten of them (Poe, Dickens and Melville 1951), of 1.5 m",
        "Poe 1951",
    )
    assert shipped("b")[3:] == ("", "")


def test_existing_file_takes_precedence_over_a_name(tmp_path):
    assert find_config("hexapod") == CONFIGS / "hexapod.yaml"
    Path("hexapod").write_text("name: mine\n")
    assert find_config("hexapod") == find_config(Path("./hexapod")) == Path("hexapod")


def test_folder_takes_precedence_only_if_folders_are_allowed():
    Path("hexapod").mkdir()
    Path("mine").mkdir()
    assert find_config("hexapod") == CONFIGS / "hexapod.yaml"
    assert find_config("hexapod", folders=True) == Path("hexapod")
    assert find_config("mine") == Path("mine")


@pytest.mark.parametrize("path", ["x.yaml", "configs/hexapod", "hexapod.yaml", "../x", "/x", ".."])
def test_text_with_a_folder_or_suffix_is_a_path(path):
    assert find_config(path) == Path(path)


@pytest.mark.parametrize("name", ["hexapodd", "a" * 5000, "a\0b"])
def test_unknown_name_gets_the_nearest_name(name):
    with pytest.raises(ConfigError, match="no such file here, and no configuration") as caught:
        find_config(name)
    near = "did you mean 'hexapod' or 'hexapod_tripod'?"
    assert (near in str(caught.value)) == (name == "hexapodd")
    assert str(caught.value).endswith(" `evo-cpg configs` lists all names")
    with pytest.raises(ConfigError, match=r"no configuration of this name comes with evo-cpg[:.] "):
        shipped(name)


@pytest.mark.parametrize(
    ("find", "name", "word"),
    [
        (find_config, "swimer", "'evolving_swimmer', 'iwadate2010_swimmer', 'swimmer_"),
        (find_config, "mine", r"'mine\.yaml'"),
        (load_config, "hexapod.yaml", "no such file.* hexapod$"),
        (load_config, "configs/hexapod.yaml", "no such file.* hexapod$"),
    ],
)
def test_similar_names_and_files_are_named(find, name, word):
    Path("mine.yaml").touch()
    with pytest.raises(ConfigError, match=f"^{name}: .*{word}"):
        find(name)


@some_configs
def test_a_copy_contains_all_files(path, tmp_path):
    name = path.stem
    made = copy_shipped(name, tmp_path / "new" / "folder")
    assert made == tmp_path / "new" / "folder" / f"{name}.yaml"
    assert load_config(made) == load_config(path)
    files = [file for file in (tmp_path / "new").rglob("*") if file.is_file()]
    # Plans evolve their creatures, so these have no file.
    assert 2 - name.startswith(("virtual_", "follow_")) <= len(files) <= 3
    for file in files:
        assert filecmp.cmp(file, CONFIGS / file.relative_to(made.parent), shallow=False)


def test_meshes_are_copied_too(tmp_path, monkeypatch):
    import trimesh

    theirs = tmp_path / "theirs"
    (theirs / "creatures" / "meshes").mkdir(parents=True)
    trimesh.creation.box((0.1, 0.1, 0.1)).export(theirs / "creatures" / "meshes" / "box.stl")
    (theirs / "creatures" / "lump.yaml").write_text(
        "name: lump\nmaterials: {stuff: {density: 1000}}\nlight_sensors: [{body: lump}]\n"
        "bodies: [{name: lump, shape: {type: mesh, file: meshes/box.stl}, material: stuff}]\n"
    )
    (theirs / "lump.yaml").write_text("name: lump\ncreature: creatures/lump.yaml\n")
    monkeypatch.setattr(module, "shipped_folder", lambda: theirs)
    made = copy_shipped("lump", tmp_path / "mine")
    assert (tmp_path / "mine" / "creatures" / "meshes" / "box.stl").is_file()
    assert load_config(made) == load_config(theirs / "lump.yaml")


def test_nothing_is_copied_if_a_folder_cannot_be_created(tmp_path):
    (tmp_path / "creatures").write_text("mine")
    with pytest.raises(OSError, match="creatures"):
        copy_shipped("hexapod", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["creatures"]


def test_a_copy_replaces_no_file(tmp_path):
    copy_shipped("salamander_boulders", tmp_path)
    # Both use the same creature.
    copy_shipped("salamander_amphibious", tmp_path)
    changed = tmp_path / "creatures" / "salamander.yaml"
    changed.write_text("mine")
    with pytest.raises(
        ConfigError, match=r"salamander\.yaml: already exists and differs from the file"
    ):
        copy_shipped("iwadate2010_salamander_land", tmp_path)
    assert changed.read_text() == "mine"
    assert not (tmp_path / "iwadate2010_salamander_land.yaml").exists()
    assert not list(tmp_path.rglob("*.partial"))
