"""Folder of compiled programs, and cases in which none can be kept."""

import os

import jax
import pytest

from evo_cpg.training.devices import _prune, keep_compiled_programs

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


def test_the_oldest_programs_are_deleted_first(tmp_path):
    for age, name in enumerate(("new", "middle", "old")):
        (tmp_path / name).write_bytes(bytes(100))
        os.utime(tmp_path / name, (1000 - age, 1000 - age))
    _prune(tmp_path, 250)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["middle", "new"]


def test_files_that_another_process_deletes_are_skipped(tmp_path):
    (tmp_path / "gone").symlink_to("renamed")
    (tmp_path / "there").write_bytes(bytes(100))
    _prune(tmp_path, 50)
    assert [file.name for file in tmp_path.iterdir()] == ["gone"]
