"""Outputs appear whole or not at all."""

from __future__ import annotations

import os

import pytest
from orthoscale.atomic import check_free, new_file, new_folder

from orthoscale.errors import OutputError, UsageError


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def test_file_appears_at_the_end(tmp_path):
    with new_file(tmp_path / "a.tif") as partial:
        assert partial.suffix == ".tif" and partial.parent.parent == tmp_path
        partial.write_text("new")
        assert not (tmp_path / "a.tif").exists()
    assert (tmp_path / "a.tif").read_text() == "new" and names(tmp_path) == ["a.tif"]


@pytest.mark.parametrize("name", ["model", "replaced", "model.former"])
def test_folder_appears_at_the_end(tmp_path, name):
    for text in ("first", "second"):
        with new_folder(tmp_path / name, overwrite=True) as partial:
            (partial / "x").write_text(text)
            (partial / f"of {text}").touch()
        assert names(tmp_path) == [name] and names(tmp_path / name) == [f"of {text}", "x"]


def test_relative_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    from pathlib import Path

    with new_file(Path("a.txt")) as partial:
        partial.write_text("new")
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, UsageError])
@pytest.mark.parametrize("new", [new_file, new_folder])
def test_nothing_is_left_after_an_error(tmp_path, new, error):
    with pytest.raises(error), new(tmp_path / "a") as partial:
        if new is new_file:
            partial.write_text("half")
        else:
            (partial / "x").write_text("half")
        raise error("stop")
    assert names(tmp_path) == []


@pytest.mark.parametrize("new", [new_file, new_folder])
def test_former_output_survives_an_error(tmp_path, new):
    (tmp_path / "a").mkdir() if new is new_folder else (tmp_path / "a").write_text("former")
    with pytest.raises(RuntimeError), new(tmp_path / "a", overwrite=True):
        raise RuntimeError
    assert names(tmp_path) == ["a"]


def test_former_folder_comes_back_when_the_new_one_cannot_take_its_place(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "precious").touch()
    really = os.replace

    def replace(source, target):
        if os.path.basename(os.path.dirname(source)).endswith(".partial") and os.path.basename(source) == "a":
            raise OSError(28, "No space left on device")
        really(source, target)

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(OutputError, match="No space"), new_folder(tmp_path / "a", overwrite=True):
        pass
    assert names(tmp_path) == ["a"] and names(tmp_path / "a") == ["precious"]


@pytest.mark.parametrize("new", [new_file, new_folder])
def test_existing_output_is_refused_before_work_starts(tmp_path, new):
    (tmp_path / "a").write_text("former")
    with pytest.raises(UsageError, match="already exists"), new(tmp_path / "a"):
        pytest.fail("must not get here")
    assert (tmp_path / "a").read_text() == "former"


def test_a_file_does_not_replace_a_folder(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(OutputError), new_file(tmp_path / "a", overwrite=True) as partial:
        partial.write_text("new")
    assert (tmp_path / "a").is_dir() and names(tmp_path) == ["a"]


def test_missing_parent(tmp_path):
    with pytest.raises(OutputError, match="not a folder"):
        check_free(tmp_path / "none" / "a", overwrite=False)


def test_full_disk_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="No space") as caught, new_file(tmp_path / "a"):
        raise OSError(28, "No space left on device")
    assert caught.value.exit_code == 6 and names(tmp_path) == []


def test_unwritable_place(tmp_path, monkeypatch):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    with pytest.raises(OutputError, match="Permission denied"), new_file(tmp_path / "a"):
        pytest.fail("must not get here")
