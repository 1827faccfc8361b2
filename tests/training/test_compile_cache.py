"""Folder of compiled programs, and cases in which none can be kept."""

import os

import jax
import pytest

from evo_cpg.training import devices
from evo_cpg.training.devices import keep_compiled_programs

OPTIONS = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")


@pytest.fixture(autouse=True)
def restored_options(monkeypatch, tmp_path):
    before = {name: getattr(jax.config, name) for name in OPTIONS}
    jax.config.update("jax_compilation_cache_dir", None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    yield
    for name, value in before.items():
        jax.config.update(name, value)


def test_programs_have_a_folder_for_each_kind_of_processor(tmp_path):
    folder = keep_compiled_programs()
    assert folder is not None and folder.is_dir()
    assert folder.parent == tmp_path / "cache" / "evo_cpg" / "compiled"
    assert jax.config.jax_compilation_cache_dir == str(folder)


def test_the_users_own_folder_stays():
    jax.config.update("jax_compilation_cache_dir", "/somewhere/else")
    assert keep_compiled_programs() is None
    assert jax.config.jax_compilation_cache_dir == "/somewhere/else"


def test_nothing_is_kept_without_a_writable_folder(tmp_path):
    (tmp_path / "cache").write_text("a file where the folder should be")
    assert keep_compiled_programs() is None
    assert jax.config.jax_compilation_cache_dir is None


def keep_again(monkeypatch, most: int) -> None:
    """Keep programs in the default folder, and at most this many bytes of them."""
    jax.config.update("jax_compilation_cache_dir", None)
    monkeypatch.setattr(devices, "_MOST", most)
    assert keep_compiled_programs() is not None


def test_the_oldest_programs_are_deleted_first(monkeypatch):
    folder = keep_compiled_programs()
    assert folder is not None
    for age, name in enumerate(("new", "middle", "old")):
        (folder / name).write_bytes(bytes(100))
        os.utime(folder / name, (1000 - age, 1000 - age))
    keep_again(monkeypatch, 250)
    assert sorted(file.name for file in folder.iterdir()) == ["middle", "new"]


def test_files_that_another_process_deletes_are_skipped(monkeypatch):
    folder = keep_compiled_programs()
    assert folder is not None
    (folder / "gone").symlink_to("renamed")
    (folder / "there").write_bytes(bytes(100))
    keep_again(monkeypatch, 50)
    assert [file.name for file in folder.iterdir()] == ["gone"]
