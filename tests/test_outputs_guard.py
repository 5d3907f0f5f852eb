"""Nothing is lost: outputs are refused where they could touch an input or what others wrote, and appear whole or not
at all."""

from __future__ import annotations

import csv
import errno
import json
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from support.in_process import run
from support.pictures import squares

import orthoscale
from orthoscale.actions.fix import fix
from orthoscale.errors import Incomplete, InputError, OrthoscaleError, OutputError, UsageError
from orthoscale.formats.csv_table import write_csv
from orthoscale.system import reserved, stopping
from orthoscale.system.outputs import Outputs
from orthoscale.system.signatures import (
    BLOCK_BYTES,
    FOLDER_MARK,
    ours,
    ours_in_a_folder,
    room,
    signature,
    was_changed,
    written_in_metres,
)
from orthoscale.system.threads import Threads
from orthoscale.system.untouched import existing

EXAMPLES = Path(__file__).parent.parent / "examples"
MODEL, BOXES = EXAMPLES / "sheffield" / "sparse", EXAMPLES / "sheffield" / "detections.json"
RULES = ("--detections", BOXES, "--fleet", "US", "--mode", "planar")  # the quickest way to measure it


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def state(folder):
    """All that must not change: names, contents, links."""
    return {
        p.relative_to(folder): os.readlink(p) if p.is_symlink() else p.read_bytes() if p.is_file() else None
        for p in sorted(folder.rglob("*"))
    }


def write_file(path, text="new", **options):
    with Outputs(**options) as outputs:
        outputs.file(path).write_text(json.dumps({"text": text}))


def write_folder(path, files=("x",), text="new", **options):
    with Outputs(**options) as outputs:
        folder = outputs.folder(path)
        for name in files:
            (folder / name).write_text(text)


BOTH = pytest.mark.parametrize("write", [write_file, write_folder])


# Whole or not at all


def test_a_file_appears_at_the_end(tmp_path):
    with Outputs() as outputs:
        partial = outputs.file(tmp_path / "a.tif")
        assert partial.name == "a.tif" and partial.parent.parent.parent == tmp_path
        partial.write_text("new")
        assert not (tmp_path / "a.tif").exists()
    assert (tmp_path / "a.tif").read_text() == "new" and names(tmp_path) == ["a.tif"]


@pytest.mark.parametrize("name", ["model", "new", "former", "lock"])
def test_a_folder_appears_at_the_end_and_is_replaced_as_a_whole(tmp_path, name):
    for text in ("first", "second"):
        write_folder(tmp_path / name, ("x", f"of {text}"), text, overwrite=True)
        assert names(tmp_path) == [name] and names(tmp_path / name) == [FOLDER_MARK, f"of {text}", "x"]
        assert ours(tmp_path / name)


def test_relative_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_file(Path("a.json"))
    write_file(Path("a.json"), overwrite=True)
    assert names(tmp_path) == ["a.json"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, UsageError])
@BOTH
def test_nothing_is_left_after_an_error(tmp_path, write, error, monkeypatch):
    write(tmp_path / "a")
    before = state(tmp_path)

    def stop(*_):
        raise error("stop")

    monkeypatch.setattr(reserved, "sign_file" if write is write_file else "sign_folder", stop)
    for path in ("a", "b"):
        with pytest.raises(error):
            write(tmp_path / path, overwrite=True)
        assert state(tmp_path) == before


@pytest.mark.parametrize("exchange", [True, False])
def test_all_outputs_change_places_or_none_does(tmp_path, monkeypatch, exchange):
    """The second rename fails: what the first did is undone, with and without Linux's exchange of names."""
    if not exchange:
        monkeypatch.setattr(reserved, "_renameat2", lambda *_: False)
    for name in ("main.json", "part.json", "stale.json"):
        write_file(tmp_path / name)
    before = state(tmp_path)
    place = reserved.Reserved.place

    def failing(claim):
        if claim.path.name == "stale.json":
            raise OSError(28, "No space left on device")
        place(claim)

    def again():
        with Outputs(overwrite=True) as outputs:
            partials = [outputs.file(tmp_path / name) for name in ("main.json", "part.json", "fresh.json")]
            for partial in partials:
                partial.write_text('{"text": "newer"}')
            outputs.retire(tmp_path / "stale.json")

    with monkeypatch.context() as patch:
        patch.setattr(reserved.Reserved, "place", failing)
        with pytest.raises(OutputError, match="No space"):
            again()
    assert state(tmp_path) == before
    again()
    assert names(tmp_path) == ["fresh.json", "main.json", "part.json"]
    assert all("newer" in (tmp_path / name).read_text() for name in names(tmp_path))


@pytest.mark.parametrize("exchange", [True, False])
@BOTH
def test_what_appears_meanwhile_is_not_replaced(tmp_path, monkeypatch, write, exchange):
    if not exchange:
        monkeypatch.setattr(reserved, "_renameat2", lambda *_: False)
    sign = "sign_file" if write is write_file else "sign_folder"
    really = getattr(reserved, sign)
    for overwrite, way in ((False, Path.mkdir), (True, Path.touch), (False, Path.touch)):
        path = tmp_path / f"{overwrite} {way.__name__}"

        def somebody_else(*partial, way=way, path=path):
            way(path)
            really(*partial)

        with monkeypatch.context() as patch, pytest.raises(UsageError, match="somebody else"):
            patch.setattr(reserved, sign, somebody_else)
            write(path, overwrite=overwrite)
        assert path.exists() and not (path.is_dir() and any(path.iterdir()))
    assert len(names(tmp_path)) == 3


def test_what_was_changed_meanwhile_is_not_replaced(tmp_path):
    write_folder(tmp_path / "a")
    with pytest.raises(UsageError, match="meanwhile"), Outputs(overwrite=True) as outputs:
        outputs.folder(tmp_path / "a")
        (tmp_path / "a" / "precious").touch()
    assert names(tmp_path) == ["a"] and "precious" in names(tmp_path / "a")


@BOTH
def test_a_run_that_ends_just_before_the_lock_is_taken_is_not_replaced(tmp_path, monkeypatch, write):
    really = reserved._locked

    def after_another_run(scratch, path):
        with monkeypatch.context() as patch:
            patch.setattr(reserved, "_locked", really)
            write(path, text="of the other run")
        return really(scratch, path)

    with monkeypatch.context() as patch, pytest.raises(UsageError, match="already exists"):
        patch.setattr(reserved, "_locked", after_another_run)
        write(tmp_path / "a", text="mine")
    assert names(tmp_path) == ["a"] and ours(tmp_path / "a")
    file = tmp_path / "a/x" if write is write_folder else tmp_path / "a"
    assert "of the other run" in file.read_text()


@BOTH
def test_what_a_killed_run_had_put_aside_is_not_replaced_either(tmp_path, monkeypatch, write):
    write(tmp_path / "a", text="precious")
    before = state(tmp_path)
    killed = reserved.Reserved(tmp_path / "a")
    killed._put_former_aside()
    os.close(killed._lock)  # as the kernel does
    with pytest.raises(UsageError, match="already exists"):
        write(tmp_path / "a", text="mine")
    assert state(tmp_path) == before


def test_a_full_disk_is_an_output_error_and_a_broken_input_is_not(tmp_path):
    with pytest.raises(OutputError, match="No space") as caught, Outputs() as outputs:
        outputs.file(tmp_path / "a")
        raise OSError(28, "No space left on device")
    assert caught.value.exit_code == 6 and names(tmp_path) == []
    assert "left behind" in caught.value.hint and "Check the free space" in caught.value.hint
    with pytest.raises(OutputError, match="full"), Outputs() as outputs:
        outputs.file(tmp_path / "a")
        raise sqlite3.OperationalError("database or disk is full")
    with pytest.raises(InputError, match="elsewhere") as caught, Outputs() as outputs:
        outputs.file(tmp_path / "a")
        (tmp_path / "elsewhere").read_bytes()
    assert caught.value.exit_code == 5 and names(tmp_path) == []


@pytest.mark.parametrize("path", ["none/a", "x" * 256])
@BOTH
def test_a_place_that_cannot_be(tmp_path, path, write):
    with pytest.raises(OutputError):
        write(tmp_path / path)
    assert names(tmp_path) == []


def test_a_part_that_fails_does_not_take_the_others_away(tmp_path):
    write_file(tmp_path / "part.json", "of a former run")
    with Outputs(overwrite=True) as outputs:
        main, part = outputs.file(tmp_path / "main.json"), outputs.file(tmp_path / "part.json")
        main.write_text("{}")
        with outputs.attempt(part, part.name):
            part.write_text("half")
            raise OSError(28, "No space left on device")
    assert names(tmp_path) == ["main.json"], "the former part would speak for the new main output"
    assert outputs.missing() == "part.json could not be written (No space left on device)"


# What is orthoscale's


def png(path):
    cv2.imwrite(str(path), np.full((20, 30, 3), 90, np.uint8))


def geopackage(path):
    import shapely

    from orthoscale.formats.vector import write_layer

    write_layer(path, "places", [shapely.Point(1, 2)], [{"a": 1}], "Point", "EPSG:4326")


CONTENT = {
    "a.json": lambda path: path.write_text('{\n "a": [{}]\n}\n'),
    "a.html": lambda path: path.write_text("<!doctype html><html></html>\n"),
    "a.png": png,
    "a.gpkg": geopackage,
    "a.csv": lambda path: write_csv(path, ["a", "b"], [{"a": '1"', "b": "2\r\n3"}, {"a": "é", "b": None}]),
    "none.csv": lambda path: write_csv(path, ["a", "b"], []),
}
SIGNED = {
    "a.txt": lambda path: path.write_text(f"imagesource:{room(path)}\n"),
    # The signature, or the CRC-32 after it, lies in two of the blocks that are read.
    "two.txt": lambda path: path.write_text("a" * (BLOCK_BYTES - 20) + room(path) + "a" * BLOCK_BYTES),
    "too.txt": lambda path: path.write_text("a" * (BLOCK_BYTES - 38) + room(path) + "a" * BLOCK_BYTES),
}


@pytest.mark.parametrize("name", CONTENT)
def test_files_carry_a_mark_that_their_readers_do_not_mind(tmp_path, name):
    path = tmp_path / name
    CONTENT[name](path)
    assert not ours(path)
    foreign = path.read_bytes()
    with pytest.raises(UsageError, match="was not written by orthoscale"):
        write_file(path, overwrite=True)
    assert path.read_bytes() == foreign
    path.unlink()
    for overwrite in (False, True):
        with Outputs(overwrite) as outputs:
            CONTENT[name](outputs.file(path))
        assert ours(path)
    with pytest.raises(UsageError, match="already exists"):
        write_file(path)
    if name == "a.json":
        text = json.loads(path.read_text())
        assert text.pop("written_by").startswith(signature(path)) and text == {"a": [{}]}
    elif name == "a.png":
        assert (cv2.imread(str(path)) == 90).all()
    elif name == "a.gpkg":
        from pyogrio import list_layers, read_info

        assert [layer for layer, _ in list_layers(path)] == ["places"] and read_info(path)["features"] == 1
    elif name == "a.csv":
        first, second = csv.DictReader(path.open(newline=""))
        assert first.pop("written_by").startswith(signature(path)) and first == {"a": '1"', "b": "2\r\n3"}
        assert second == {"a": "é", "b": "", "written_by": ""}
    elif name == "none.csv":
        assert path.read_text().startswith("a,b,") and len(path.read_text().splitlines()) == 1
    shutil.copy(path, tmp_path / f"mine{path.suffix}")
    assert not ours(tmp_path / f"mine{path.suffix}"), "a copy under another name is somebody's own"


@pytest.mark.parametrize("name", [*SIGNED, *sorted(set(CONTENT) - {"a.gpkg"})])
def test_a_file_that_was_edited_is_not_replaced(tmp_path, name):
    """A table in which a value was corrected, say: it was lost."""
    path = tmp_path / name
    with Outputs() as outputs:
        (SIGNED | CONTENT)[name](outputs.file(path))
    written = path.read_bytes()
    for place in {0, len(written) // 4, len(written) - 1} - {-1}:
        path.write_bytes(written[:place] + bytes([written[place] ^ 1]) + written[place + 1 :])
        assert not ours(path)
        with pytest.raises(UsageError, match="(was changed since|was not written by) orthoscale"):
            write_file(path, overwrite=True)
    path.write_bytes(written)
    assert ours(path)


@pytest.mark.parametrize("make", ["empty", "full", "stranger", "copy", "damaged", "link"])
def test_only_a_folder_that_orthoscale_filled_is_replaced(tmp_path, make):
    path = tmp_path / "a"
    if make in ("empty", "full"):
        path.mkdir()
    if make == "full":
        (path / "precious").touch()
    if make in ("stranger", "damaged"):
        write_folder(path)
        (path / ("precious" if make == "stranger" else FOLDER_MARK)).write_text("{")
    if make in ("copy", "link"):
        write_folder(tmp_path / "b")
        shutil.copytree(tmp_path / "b", path) if make == "copy" else path.symlink_to(tmp_path / "b")
    before = state(tmp_path)
    for write in (write_folder, write_file):
        for overwrite in (False, True):
            with pytest.raises(UsageError) as caught:
                write(path, overwrite=overwrite)
            assert "--overwrite" not in caught.value.hint, "it would be refused as well"
    assert state(tmp_path) == before


def test_a_folder_within_a_folder_may_be_replaced_alone(tmp_path):
    with Outputs() as outputs:
        write_folder(outputs.folder(tmp_path / "all") / "0")
    write_folder(tmp_path / "all/0", ("x", "y"), overwrite=True)
    assert ours(tmp_path / "all")
    (tmp_path / "all/0/precious").touch()
    assert not ours(tmp_path / "all")


@pytest.mark.parametrize("changed", ["x", "0/x"])
def test_a_folder_whose_files_were_changed_since_is_not_replaced(tmp_path, changed):
    """Bundle adjustment run in place: the folder counted as orthoscale's, and the refined model was lost."""
    with Outputs() as outputs:
        folder = outputs.folder(tmp_path / "all")
        (folder / "x").write_text("old")
        write_folder(folder / "0", text="old")
    file = tmp_path / "all" / changed
    written = file.stat()
    file.write_text("own")  # as many bytes
    before = state(tmp_path)
    said = f"all holds {changed}, which was changed since orthoscale wrote it, so it is not replaced"
    with pytest.raises(UsageError, match=said) as caught:
        write_folder(tmp_path / "all", overwrite=True)
    assert caught.value.hint == "Choose another place, or delete it yourself." and state(tmp_path) == before
    file.write_text("old")
    assert file.stat().st_mtime_ns > written.st_mtime_ns
    write_folder(tmp_path / "all", overwrite=True)


def test_a_changed_file_is_noticed_behind_one_of_somebody_else(tmp_path):
    """The first file that was not orthoscale's own hid it, and the copy counted as finished."""
    with Outputs() as outputs:
        write_folder(outputs.folder(tmp_path / "all") / "0", text="old")
    (tmp_path / "all/which was changed since orthoscale wrote it").touch()
    assert not was_changed(tmp_path / "all") and not was_changed(tmp_path / "all/0/x")
    (tmp_path / "all/0/x").write_text("own")
    assert was_changed(tmp_path / "all")


def test_a_geopackage_in_a_folder_may_be_looked_at(tmp_path):
    """QGIS changes its bytes by opening it."""
    with Outputs() as outputs:
        geopackage(outputs.folder(tmp_path / "plan") / "layout.gpkg")
    path = tmp_path / "plan/layout.gpkg"
    written = path.read_bytes()
    with closing(sqlite3.connect(path)) as viewer:
        viewer.execute("PRAGMA journal_mode=WAL")
        viewer.execute("PRAGMA journal_mode=DELETE")
    assert path.read_bytes() != written and ours(tmp_path / "plan")
    with closing(sqlite3.connect(path)) as editor, editor:
        editor.execute("UPDATE gpkg_contents SET identifier = 'mine'")
    assert not ours(tmp_path / "plan")


@pytest.mark.parametrize("how", ["a pipe", "deep", "a list"])
def test_a_mark_that_somebody_else_made_is_none(tmp_path, how):
    """Marks are looked for in all folders above an input: that of /tmp is anybody's."""
    mark = tmp_path / FOLDER_MARK
    os.mkfifo(mark) if how == "a pipe" else mark.write_text("[" * 100_000 if how == "deep" else "[1]")
    (tmp_path / "model").mkdir()
    assert not written_in_metres(tmp_path / "model") and not ours(tmp_path)


def test_a_part_of_a_folder_may_be_replaced_alone_unless_it_was_changed(tmp_path):
    write_folder(tmp_path / "a", ("report.html", "other.html"))
    (tmp_path / "a/other.html").write_text("<!-- my notes -->")
    assert not ours_in_a_folder(tmp_path / "a/other.html")
    with Outputs(overwrite=True) as outputs:
        outputs.file(tmp_path / "a/report.html", ours_in_a_folder).write_text("<html></html>")
    (tmp_path / "a/other.html").write_text("new")
    assert ours(tmp_path / "a"), "a report that was drawn again is signed itself"
    with (tmp_path / "a/report.html").open("a") as page:
        page.write("<!-- my notes -->")
    with pytest.raises(UsageError, match="report.html was changed since"):
        Outputs(overwrite=True).file(tmp_path / "a/report.html", ours_in_a_folder)
    assert not ours(tmp_path / "a")


def test_a_geopackage_that_was_edited_is_not_replaced(tmp_path):
    """QGIS's plugin overwrites without being asked."""
    path = tmp_path / "a.gpkg"
    with Outputs() as outputs:
        geopackage(outputs.file(path))
    with closing(sqlite3.connect(path)) as viewer:
        viewer.execute("PRAGMA journal_mode=WAL")
        viewer.execute("PRAGMA journal_mode=DELETE")
    with Outputs(overwrite=True) as outputs:
        geopackage(outputs.file(path))
    older = tmp_path / "older.gpkg"
    geopackage(older)
    with closing(sqlite3.connect(path)) as editor, closing(sqlite3.connect(older)) as former, editor, former:
        editor.execute("UPDATE gpkg_contents SET identifier = 'mine'")
        former.execute("UPDATE gpkg_contents SET description = ?", (signature(older),))
    before = state(tmp_path)
    with pytest.raises(UsageError, match="a.gpkg was changed since orthoscale wrote it, so it is not replaced"):
        write_file(path, overwrite=True)
    assert state(tmp_path) == before and ours(older)


def test_a_geopackage_that_is_open_elsewhere_is_not_replaced(tmp_path):
    """Whoever opened the new one was given the former one's changes, from the log beside it."""
    path = tmp_path / "a.gpkg"
    for _ in range(2):
        with Outputs(overwrite=True) as outputs:
            geopackage(outputs.file(path))
    with closing(sqlite3.connect(path)) as other:
        other.execute("PRAGMA journal_mode=WAL")
        other.execute("PRAGMA user_version = 7")
        with pytest.raises(UsageError, match="a.gpkg-wal would be taken for a part of the new a.gpkg") as caught:
            Outputs(overwrite=True).check(path)
        assert "QGIS" in caught.value.hint
    Outputs(overwrite=True).check(path)


def test_kinds_do_not_replace_each_other(tmp_path):
    write_file(tmp_path / "file")
    write_folder(tmp_path / "folder")
    before = state(tmp_path)
    with pytest.raises(UsageError, match="is a file"):
        write_folder(tmp_path / "file", overwrite=True)
    with pytest.raises(UsageError, match="is a folder"):
        write_file(tmp_path / "folder", overwrite=True)
    assert state(tmp_path) == before


# Inputs


@pytest.fixture
def inputs(tmp_path):
    """Our own outputs as inputs, so that nothing but their being inputs protects them."""
    write_folder(tmp_path / "folder", ("in",))
    (tmp_path / "sub").mkdir()
    write_folder(tmp_path / "sub/folder", ("in",))
    write_file(tmp_path / "a.tif")
    write_file(tmp_path / "sub/b.tif")
    (tmp_path / "link.tif").symlink_to(tmp_path / "a.tif")
    (tmp_path / "via").symlink_to(tmp_path / "sub")
    os.link(tmp_path / "a.tif", tmp_path / "hard.tif")
    return tmp_path


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize(
    "given, out",
    [
        ("a.tif", "a.tif"),
        ("a.tif", "sub/../a.tif"),
        ("a.tif", "link.tif"),
        ("link.tif", "a.tif"),
        ("a.tif", "hard.tif"),
        ("sub/b.tif", "via/b.tif"),
        ("via/b.tif", "sub/b.tif"),
        ("sub/b.tif", "sub"),
        ("link.tif", "."),
        ("folder", "folder"),
        ("folder", "."),
        ("folder", "folder/new"),
        ("folder", "folder/in"),
        ("sub/folder", "via/folder/new"),
        ("sub/folder", "via"),
        ("a.tif", "a.tfw"),
        ("a.tif", "A.TFW"),
        ("a.tif", "a.tifw"),
        ("a.tif", "a.wld"),
        ("a.tif", "a.prj"),
        ("a.tif", "a.tif.aux.xml"),
        ("a.tif", "a.tif.ovr"),
        ("link.tif", "link.tfw"),
        ("link.tif", "a.tfw"),
        ("via/b.tif", "sub/b.tfw"),
    ],
)
def test_an_output_never_touches_an_input(inputs, given, out, overwrite):
    before = state(inputs)
    for kind in ("file", "folder"):
        with pytest.raises(UsageError) as caught, Outputs(overwrite, (None, [str(inputs / given)])) as outputs:
            getattr(outputs, kind)(inputs / out)
        assert caught.value.exit_code == 2 and "Inputs are never touched" in caught.value.hint
        with pytest.raises(UsageError), Outputs(overwrite) as outputs:  # one that is found later
            getattr(outputs, kind)(inputs / out)
            outputs.protect(inputs / given)
    assert state(inputs) == before


def test_neighbours_of_an_input_are_free(inputs):
    for name in ("a.tif.json", "b.tfw", "folder2", "a.tiff"):
        write_file(inputs / name, inputs=[inputs / "a.tif", inputs / "folder"])


def test_inputs_are_all_that_exists_among_what_was_given(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a").touch()
    assert existing((Path("a"), Path("b"), None, ([Path("a")],))) == [Path("a")] * 2
    assert existing(None) == []


@pytest.mark.parametrize("first, second", [("a.json", "a.json"), ("a.json", "x/../a.json"), ("d", "d/a"), ("d/a", "d")])
def test_two_outputs_never_share_a_place(tmp_path, first, second):
    (tmp_path / "x").mkdir()
    write_folder(tmp_path / "d", ("b",))
    before = state(tmp_path)
    with pytest.raises(UsageError), Outputs(overwrite=True) as outputs:
        outputs.check(tmp_path / "d")
        outputs.file(tmp_path / first) if first != "d" else outputs.folder(tmp_path / first)
        outputs.file(tmp_path / second) if second != "d" else outputs.folder(tmp_path / second)
    assert state(tmp_path) == before


# Other runs


@BOTH
def test_of_two_writers_the_second_is_refused(tmp_path, write):
    with Outputs() as outputs:
        partial = outputs.file(tmp_path / "a.json")
        with pytest.raises(UsageError, match="being written by another run"):
            write(tmp_path / "a.json")
        with pytest.raises(UsageError, match="being written by another run"):
            write(tmp_path / "a.json", overwrite=True)
        partial.write_text('{"text": "first"}')
    assert "first" in (tmp_path / "a.json").read_text() and names(tmp_path) == ["a.json"]


@pytest.mark.skipif(reserved.fcntl is None, reason="there are no locks here")
@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
@BOTH
def test_a_drive_without_locks_is_written_to(tmp_path, monkeypatch, write, code):
    def none_here(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(reserved.fcntl, "flock", none_here)
    write(tmp_path / "a.json")
    with Outputs(overwrite=True) as outputs:
        outputs.file(tmp_path / "b.json").write_text("{}")
        with pytest.raises(UsageError, match="being written by another run"):
            write(tmp_path / "b.json", overwrite=True)
    assert names(tmp_path) == ["a.json", "b.json"]


@pytest.mark.skipif(reserved.fcntl is None, reason="there are no locks here")
@BOTH
def test_a_lock_that_fails_leaves_nothing(tmp_path, monkeypatch, write):
    def broken(*_):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(reserved.fcntl, "flock", broken)
    with pytest.raises(OutputError, match="Input/output error"):
        write(tmp_path / "a.json")
    assert names(tmp_path) == []


@BOTH
def test_a_network_drive_that_says_last_that_it_is_full(tmp_path, monkeypatch, write):
    """Only when all is to be on its disk; then nothing has been replaced yet."""
    write(tmp_path / "a.json", text="former")
    before = state(tmp_path)

    def full(_):
        raise OSError(errno.EDQUOT, "Disk quota exceeded")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="quota"):
        write(tmp_path / "a.json", overwrite=True)
    assert state(tmp_path) == before


WRITER = """
import os, signal, sys
from pathlib import Path
from orthoscale.system.outputs import Outputs
with Outputs(overwrite=True) as outputs:
    outputs.folder(Path(sys.argv[1])).joinpath("half").write_text("half")
    print("ready", flush=True)
    signal.pause()
"""


@pytest.mark.slow
def test_what_a_killed_run_left_is_removed_by_the_next(tmp_path):
    write_folder(tmp_path / "a", text="former")
    with subprocess.Popen([sys.executable, "-c", WRITER, tmp_path / "a"], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        with pytest.raises(UsageError, match="another run"):
            write_folder(tmp_path / "a", overwrite=True)
        process.kill()
    assert len(names(tmp_path)) == 2 and (tmp_path / "a/x").read_text() == "former"
    write_folder(tmp_path / "a", overwrite=True)
    assert names(tmp_path) == ["a"] and (tmp_path / "a/x").read_text() == "new"


def test_a_former_output_that_a_killed_run_had_put_aside_comes_back(tmp_path, monkeypatch):
    write_folder(tmp_path / "a", text="former")
    monkeypatch.setattr(reserved, "_renameat2", lambda *_: False)
    with monkeypatch.context() as patch:
        patch.setattr(reserved.Reserved, "release", lambda claim: os.close(claim._lock))
        patch.setattr(reserved.Reserved, "undo", lambda claim: None)
        claim = reserved.Reserved(tmp_path / "a")
        claim._put_former_aside()
        claim.release()
    assert not (tmp_path / "a").exists()
    with pytest.raises(ZeroDivisionError), Outputs(overwrite=True) as outputs:
        outputs.folder(tmp_path / "a")
        raise ZeroDivisionError
    assert names(tmp_path) == ["a"] and (tmp_path / "a/x").read_text() == "former"


@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_what_only_looks_like_left_over_is_left_alone(tmp_path, kind):
    with Outputs() as outputs:
        partial = outputs.file(tmp_path / "a")
        partial.touch()
        scratch = partial.parent.parent
    (tmp_path / "a").unlink()
    if kind == "file":
        scratch.write_text("precious")
    else:
        (tmp_path / "theirs").mkdir()
        (tmp_path / "theirs/precious").touch()
        (tmp_path / "theirs").rename(scratch) if kind == "folder" else scratch.symlink_to(tmp_path / "theirs")
    before = state(tmp_path)
    with pytest.raises(UsageError, match="in the way"):
        write_file(tmp_path / "a")
    assert state(tmp_path) == before


def test_a_message_names_an_output_by_its_place_and_not_where_it_is_written_aside(tmp_path):
    out = tmp_path / "new\x1bline.txt"
    with pytest.raises(InputError) as found, Outputs() as outputs:
        raise InputError(f"{outputs.file(out)}, byte 9: announced too much", "Look.")
    assert found.value.message == rf"{tmp_path}/new\x1bline.txt, byte 9: announced too much"
    assert str(found.value).endswith("\nLook.")
    with Outputs() as outputs:
        partial = outputs.file(out)
        with outputs.attempt(partial, "the text"):
            raise InputError(f"{partial} is bad")
    assert ".partial" not in outputs.missing()


@pytest.mark.parametrize("there", ["link", "pipe", "file/out", "gone/out"])
def test_what_cannot_be_an_output_is_called_what_it_is(tmp_path, there):
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to("file")
    os.mkfifo(tmp_path / "pipe")
    reasons = {
        "link": "link is a symbolic link, so",
        "pipe": "pipe is neither a file nor a folder, so",
        "file/out": "file is not a folder",
        "gone/out": "gone does not exist",
    }
    with pytest.raises(OrthoscaleError, match=reasons[there]), Outputs(overwrite=True) as outputs:
        outputs.file(tmp_path / there)


# Signals


@pytest.fixture
def ctrl_c_is_heard():
    """A shell's background job, as this process may be, ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_a_signal_waits_while_files_change_places_and_is_not_forgotten(ctrl_c_is_heard):
    with pytest.raises(KeyboardInterrupt), stopping.listening():
        with stopping.held():
            os.kill(os.getpid(), signal.SIGTERM)
            for _ in range(100):
                pass
        pytest.fail("not answered")
    assert stopping.exit_code() == 143
    with stopping.listening():
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1)
        except KeyboardInterrupt:
            pass  # as a library may
        with pytest.raises(KeyboardInterrupt):
            stopping.check()


def test_a_signal_while_a_class_is_made_does_not_change_the_exit_code():
    """Python ends with SIGINT where a KeyboardInterrupt passed through exec, as dataclasses use it."""
    late = "import os, signal; os.kill(os.getpid(), signal.SIGTERM)\nfor _ in range(100): pass"
    program = (
        "from orthoscale.system import stopping\n"
        f"try:\n with stopping.listening(): exec({late!r})\n"
        "except KeyboardInterrupt: raise SystemExit(stopping.exit_code())"
    )
    assert subprocess.run([sys.executable, "-c", program]).returncode == 143


def test_what_becomes_of_a_signal_while_a_class_is_made_is_no_bug():
    """Python 3.11 makes a RuntimeError of what is raised in `__set_name__`."""

    class Stopping:
        def __set_name__(self, owner, name):
            os.kill(os.getpid(), signal.SIGTERM)
            for _ in range(100):
                pass

    with pytest.raises(stopping.Stopped), stopping.listening():
        type("Any", (), {"value": Stopping()})
    with pytest.raises(ValueError, match="no signal"), stopping.listening():
        raise ValueError("no signal")


def test_a_second_signal_waits_for_threads_too(ctrl_c_is_heard):
    """A network that a thread was still in aborted the process while Python ended."""
    done = []
    with pytest.raises(KeyboardInterrupt), stopping.listening(), Threads(1) as pool:
        pool.submit(lambda: (time.sleep(0.3), done.append("begun")))
        pool.submit(done.append, "not begun")
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
    assert done == ["begun"]


def test_what_is_stopped_says_no_output_that_goes_with_another(tmp_path):
    """Models of one workspace are outputs in the folder of all: written only when that is in its place."""
    with stopping.listening():
        with Outputs() as outer:
            folder = outer.folder(tmp_path / "scaled")
            with Outputs() as inner:
                (inner.folder(folder / "0") / "text").write_text("1")
            assert stopping.sentence() == "stopped; nothing was written"
        assert stopping.sentence() == f"stopped; already written: {tmp_path}/scaled"


LATE = """
import sys, time
there = sys.argv.pop()
import orthoscale.__main__ as program
from orthoscale.sources import colmap
real = colmap.ColmapSource.write
def stuck(self, folder, scale):
    real(self, folder, scale)
    assert "pycolmap" in sys.modules
    open(there, "w").close()
    time.sleep(60)
colmap.ColmapSource.write = stuck
program.main()
"""
EARLY = """
import sys, time, importlib.abc
there = sys.argv.pop()
class Slow(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == "click":
            open(there, "w").close()
            time.sleep(60)
sys.meta_path.insert(0, Slow())
import runpy
sys.argv[0] = "orthoscale"
runpy.run_module("orthoscale", run_name="__main__")
"""
# The command that is installed, while Python imports the package itself: nothing of it has heard of signals yet.
EARLIEST = EARLY.replace('"click"', '"orthoscale.version"').replace(
    'runpy.run_module("orthoscale", run_name="__main__")', "__import__('orthoscale_command').main()"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "program, how",
    [
        pytest.param(EARLIEST, signal.SIGINT, id="earliest-2"),
        *(
            pytest.param(program, how, id=f"{when}-{how:d}")
            for when, program in (("early", EARLY), ("late", LATE))
            for how in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
        ),
    ],
)
def test_a_stopped_run_leaves_nothing_and_says_so(tmp_path, program, how):
    there = tmp_path / "there"
    words = ["fix", MODEL, "--out", tmp_path / "out", *RULES, there]
    # A shell's background jobs start with Ctrl-C ignored, those of nohup with SIGHUP, and hand that on.
    listening = {"preexec_fn": lambda: signal.signal(how, signal.SIG_DFL)}
    command = [sys.executable, "-c", program, *map(str, words)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **listening) as process:
        while not there.exists() and process.poll() is None:
            time.sleep(0.02)
        process.send_signal(how)
        said = process.communicate()[1]
    assert process.returncode == 128 + how and said.strip() == "stopped; nothing was written", said
    assert names(tmp_path) == ["there"]


def test_pycolmap_is_imported_in_one_place():
    package = Path(orthoscale.__file__).parent
    found = set()
    for path in package.rglob("*.py"):
        lines = path.read_text().splitlines()
        typing = 0
        for line in lines:
            typing = line == "if TYPE_CHECKING:" or (typing and (line.startswith(" ") or not line))
            if re.match(r"\s*(import\b.*\bpycolmap\b|from pycolmap\b)", line) and not typing:
                found.add(path.relative_to(package).as_posix())
    assert found == {"sources/colmap_library.py"}


# Commands


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """Inputs of every kind. What is in them is of no account: outputs are refused before anything is read."""
    monkeypatch.chdir(tmp_path)
    for name in ("in.tif", "in.json", "in.jpg", "lot.geojson", "sat.tif", "sim3.json", "mesh.ply", "net.onnx", "f.json",
                 "lens.xml", "gcp.txt", "map.onnx", "table.csv"):  # fmt: skip
        Path(name).write_text("{}")
    shutil.copytree(MODEL, "model")
    for name in ("model", "frames", "album"):
        Path(name, "deep").mkdir(parents=True)
        Path(name, "in.txt").touch()
    return tmp_path


BOXES_OF = "--detections in.json --calibration f.json --fleet f.json"
NETWORK = "--detector net.onnx --fleet f.json"
SCENE = "--images frames --ground-control gcp.txt --against sat.tif --anchor in.json"
KEPT, SUMMARY = ("--save-detections", (".json", ".gpkg")), ("--summary", (".csv", ".html"))
COMMANDS = [  # command, all that it may be given and that goes together, an output with the endings that it may have
    ("estimate", f"in.tif {SCENE} {BOXES_OF}", KEPT),
    ("estimate", f"in.tif {SCENE} {NETWORK} --measurer net.onnx", KEPT),
    ("estimate", f"in.tif in.jpg {NETWORK}", SUMMARY),
    ("check", f"in.tif {SCENE} {BOXES_OF}", KEPT),
    ("check", f"in.tif in.jpg {NETWORK}", SUMMARY),
    ("fix", f"in.tif {SCENE} {BOXES_OF}", ("--out", (".tif",))),
    ("fix", f"in.tif {SCENE} {NETWORK} --out fresh.tif", KEPT),
    ("fix", f"model --images frames {BOXES_OF}", ("--out", ("",))),
    ("fix", f"in.tif in.jpg {NETWORK} --out fresh", SUMMARY),
    ("anchors", f"in.tif {SCENE} {BOXES_OF}", ("--out", ("", ".png", ".json", ".gpkg"))),
    ("anchors", f"in.tif {NETWORK}", ("--out", (".json",))),
    ("apply", "sim3.json mesh.ply model", ("--out", ("",))),
    ("photo", "album in.jpg --detections in.json --lens lens.xml", ("--out", (".csv", ".json", ".gpkg"))),
    ("photo", "in.jpg --depth net.onnx --detections in.json", ("--out", (".csv", ".json", ".gpkg"))),
    ("photo", f"album in.jpg {NETWORK} --calibration f.json", KEPT),
    ("crop", "in.jpg --satellite sat.tif --gsd 0.1", ("--out", ("",))),
    ("crop", f"in.jpg --satellite sat.tif {BOXES_OF} --lens lens.xml", ("--out", ("",))),
    ("crop", f"in.jpg --satellite sat.tif {NETWORK}", ("--out", ("",))),
    ("locate", f"in.jpg --satellite sat.tif {NETWORK}", ("--out", ("",))),
    ("locate", f"album in.jpg --satellite sat.tif {BOXES_OF} --lens lens.xml", ("--out", ("",))),
    (
        "locate",
        "in.jpg --satellite sat.tif --gsd 0.1 --method retrieval --embedding net.onnx --embedding-map map.onnx",
        ("--out", ("",)),
    ),
    ("layout", "in.tif --lot lot.geojson --facility tennis --avoid f.json --catalogue in.json", ("--out", ("",))),
    ("evaluate", "album --detections in.json --lens lens.xml --depth-folder frames", ("--out", (".json", ".csv"))),
    ("evaluate", "album --detector net.onnx --calibration f.json", KEPT),
    ("evaluate", "album --locate --satellite sat.tif --detections in.json", ("--out", (".json", ".csv"))),
    ("report", "in.json --images frames", ("--out", (".html",))),
    ("fleets", "--registrations table.csv", ("--out", (".json",))),
    ("calibrate", "in.tif --gsd 0.1 --detector net.onnx", ("--out", (".json",))),
]
UNWRITTEN = ("--model", "--model-detections")  # with which `check` writes nothing
REFUSED = re.compile(
    "is the input|contains the input|lies in the input|would be taken for a part of the input|already exists"
    "|so it is not replaced|cannot both be outputs"
)


def test_every_path_of_every_command_is_tried():
    from orthoscale.cli.main import COMMANDS as EVERY
    from orthoscale.cli.main import cli
    from orthoscale.cli.options import AnyPath

    missing = []
    for name in EVERY:
        command = cli.get_command(None, name)
        said = " ".join(f"{words} {out}" for of, words, (out, _) in COMMANDS if of == name)
        paths = [p for p in command.params if isinstance(p.type, AnyPath) and p.param_type_name == "option"]
        missing += [(name, p.opts) for p in paths if not any(word in (*said.split(), *UNWRITTEN) for word in p.opts)]
        assert name == "explain" or said, name
    assert not missing


@pytest.mark.parametrize("command, words, output", COMMANDS, ids=[f"{c} {o}" for c, _, (o, _) in COMMANDS])
def test_no_command_writes_onto_its_inputs_or_what_others_wrote(bench, command, words, output):
    """By any detour, with or without --overwrite. Every place has an ending that the output may have, so that nothing
    but the guard refuses it."""
    given = words.split()
    inputs = [word for word in given if os.path.exists(word)]
    assert inputs
    option, endings = output
    for ending in endings:
        places = [f"foreign{ending}"]
        if ending:
            Path(places[0]).write_text('{"precious": 1}')
        else:
            Path("foreign").mkdir()
            Path("foreign/precious").touch()
            places.append(".")
        for number, name in enumerate(inputs):
            link = f"link{number}{ending}"
            if not os.path.lexists(link):
                Path(link).symlink_to(name)
            places += [link, f"model/../{link}"]
            if os.path.isdir(name):
                places += [f"{name}/new{ending}", f"{name}/deep/new{ending}"]
            elif ending:
                if not os.path.lexists(f"hard{number}{ending}"):
                    os.link(name, f"hard{number}{ending}")
                places.append(f"{bench}/hard{number}{ending}")
            if Path(name).suffix == ending:
                places.append(name)
        before = state(bench)
        for place in places:
            for overwrite in ([], ["--overwrite"]):
                done = run(command, *given, option, place, *overwrite)
                assert done.returncode == 2 and REFUSED.search(done.stderr), (option, place, overwrite, done.stderr)
                assert state(bench) == before, (option, place)
        done = run(command, *given, option, "")
        assert done.returncode == 2 and "empty name" in done.stderr


def test_outputs_of_one_command_never_share_a_place(bench):
    shutil.copytree(MODEL, "sparse")
    twice = (2, "cannot both be outputs")
    for code, why, *words in (
        (*twice, "photo", "album", "--out", "a.csv", "--out", "./a.csv"),
        (*twice, "photo", "album", "--out", "a.json", "--save-detections", "a.json"),
        (*twice, "evaluate", "album", "--out", "a.json", "--save-detections", "a.json"),
        (*twice, "fix", "sparse", *RULES, "--out", "a.json", "--save-detections", "a.json"),
        (6, "a does not exist", "fix", "sparse", *RULES, "--out", "a", "--save-detections", "a/boxes.json"),
    ):
        before = state(bench)
        done = run(*words)
        assert done.returncode == code and why in done.stderr and done.stderr.count("\n") == 2, done.stderr
        assert state(bench) == before


# Orthophotos: many files side by side


@pytest.fixture
def ortho(tmp_path):
    """An orthophoto with a world file, and boxes that give it 0.08 m/px."""
    rng = np.random.default_rng(1)
    size = np.exp(rng.multivariate_normal(np.log([4.37, 1.79]), [[0.008, 0.003], [0.003, 0.002]], 80)) / 0.08
    places = zip(rng.uniform(60, [840, 640], (80, 2)), size, rng.uniform(-1.5, 1.5, 80), strict=True)
    rows = [{"cx": x, "cy": y, "length": a, "width": b, "angle": t, "score": 0.8} for (x, y), (a, b), t in places]
    folder = tmp_path / "here"
    folder.mkdir()
    (tmp_path / "boxes.json").write_text(json.dumps({"a.tif": rows}))
    cv2.imwrite(str(folder / "a.tif"), squares(900, 700, 0, 255))
    (folder / "a.tfw").write_text("0.1\n0\n0\n-0.1\n500\n900\n")
    return folder / "a.tif"


def fixed(ortho, out, *more):
    return run("fix", ortho, "--out", out, "--fleet", "DE", "--detections", ortho.parent.parent / "boxes.json",
               "--force", "--override", *more)  # fmt: skip


# GeoJSON needs a coordinate reference system, which a world file does not give.
ALL = [word for kind in ("tfw", "scale", "gpkg", "tiles") for word in ("--also", kind)]


def test_a_run_replaces_all_that_a_former_run_wrote_and_nothing_else(ortho):
    here, out = ortho.parent, ortho.parent / "out.tif"
    before = state(here)
    assert fixed(ortho, out, *ALL).returncode == 0
    first = set(names(here))
    assert len(first) == 2 + 1 + 3 + 4 and all(ours(here / name) for name in first if "out.tif" in name)
    (here / "out.tif.notes.txt").write_text("precious")
    (here / "out.json").write_text("precious")
    refused = fixed(ortho, out, *ALL)
    assert refused.returncode == 2 and "already exists" in refused.stderr
    whole = state(here)
    (here / "out.tif.html").write_text((here / "out.tif.html").read_text().replace("<body", "<body>My notes: <p"))
    for more in ((), ("--report", "none")):  # the page would be lost, or speak of the new copy
        refused = fixed(ortho, out, "--overwrite", *more)
        assert refused.returncode == 2 and "out.tif.html was changed since orthoscale wrote it" in refused.stderr
    (here / "out.tif.html").write_bytes(whole[Path("out.tif.html")])
    assert state(here) == whole
    assert fixed(ortho, out, *ALL, "--overwrite").returncode == 0
    assert set(names(here)) == first | {"out.tif.notes.txt", "out.json"}
    assert fixed(ortho, out, "--overwrite", "--report", "none").returncode == 0
    assert set(names(here)) == {"a.tif", "a.tfw", "out.tif", "out.tif.notes.txt", "out.json"}
    assert {name: content for name, content in state(here).items() if name in before} == before


def test_a_copy_that_was_edited_is_not_replaced(ortho):
    """As by gdal_edit, which gives it a place on the map: that was lost."""
    out = ortho.parent / "out.tif"
    assert fixed(ortho, out).returncode == 0
    with rasterio.open(out, "r+") as file:
        file.transform = rasterio.Affine(0.1, 0, 500_000, 0, -0.1, 5_000_000)
    before = state(ortho.parent)
    done = fixed(ortho, out, "--overwrite")
    assert done.returncode == 2 and "out.tif was changed since orthoscale wrote it, so it is not" in done.stderr
    assert state(ortho.parent) == before


@pytest.mark.parametrize("name", ["out.png", os.fsdecode(b"\xff.tif")])
def test_a_name_that_no_geotiff_can_have_is_refused_before_any_work(ortho, name, monkeypatch):
    monkeypatch.setattr("orthoscale.actions.fix.measured", lambda *_: pytest.fail("worked before"))
    done = fixed(ortho, ortho.parent / name)
    assert done.returncode == 2 and ("GeoTIFF" in done.stderr or "UTF-8" in done.stderr)


def test_the_georeferencing_of_the_input_stays_its_own(ortho):
    here = ortho.parent
    before = state(here)
    done = fixed(ortho, here / "a.tiff")
    assert done.returncode == 2 and "a.tfw would be taken for a part of" in done.stderr and state(here) == before
    assert f"It belongs to {ortho}: choose another name." in done.stderr  # moved away, the input would lose its place
    (here / "a.tfw").unlink()
    assert fixed(ortho, here / "a.tiff").returncode == 0
    done = fixed(ortho, here / "a.tiff", "--overwrite", "--also", "tfw")
    assert done.returncode == 2 and "part of the input" in done.stderr and not (here / "a.tfw").exists()


@pytest.mark.parametrize("name", ["out.tfw", "out.tif.gpkg", "out.tif.json", "out.tif.tiles.csv", "out.tif.ovr"])
def test_others_files_in_the_places_of_parts_stay(ortho, name):
    here = ortho.parent
    assert fixed(ortho, here / "out.tif").returncode == 0
    (here / name).write_text("1\n0\n0\n-1\n0\n0\n")
    before = state(here)
    done = fixed(ortho, here / "out.tif", "--overwrite", *ALL)
    assert done.returncode == 2 and name in done.stderr
    assert state(here) == before


@pytest.mark.parametrize("name", ["out.tfw", "out.TFW", "out.tifw", "out.wld", "out.tif.msk"])
@pytest.mark.parametrize("edited", [False, True])
def test_no_copy_is_made_beside_what_gives_it_another_scale(ortho, name, edited):
    """A world file that somebody edited, or of another picture, stayed beside the new copy, and nothing was said."""
    here = ortho.parent
    if edited:
        assert fixed(ortho, here / "out.tif", "--also", "tfw").returncode == 0
        (here / "out.tfw").rename(here / name)
    (here / name).write_text("1\n0\n0\n-1\n0\n0\n")
    before = state(here)
    for more in [[], ["--also", "tfw"]]:
        done = fixed(ortho, here / "out.tif", "--overwrite", *more)
        assert done.returncode == 2 and f"{here / name} " in done.stderr and state(here) == before
        assert "would be taken for a part of" in done.stderr or "by orthoscale under this name, or was" in done.stderr


# What fails beside a verified copy


@pytest.mark.slow
@pytest.mark.parametrize("part", ["vehicles.png", "report.html", "report.json"])
def test_a_model_is_delivered_though_its_report_fails(tmp_path, monkeypatch, part):
    where = {"vehicles.png": "draw", "report.html": "page", "report.json": "write_json"}[part]

    def fail(*_):
        raise ValueError("no such colour")

    monkeypatch.setattr(f"orthoscale.report.files.{where}", fail)
    done = run("fix", MODEL, *RULES, "--out", tmp_path / "out")
    assert done.returncode == 6 and f"{part}" in done.stderr and "no such colour" in done.stderr
    assert "Traceback" not in done.stderr and "orthoscale report" in done.stderr
    there = set(names(tmp_path / "out"))
    assert {"cameras.bin", "images.bin", "points3D.bin", "sim3.json", FOLDER_MARK} <= there and part not in there
    assert ours(tmp_path / "out") and names(tmp_path) == ["out"]
    monkeypatch.undo()
    if part != "report.json":
        page = tmp_path / ("later.png" if part == "vehicles.png" else "later.html")
        assert run("report", tmp_path / "out/report.json", "--out", page).returncode == 0
        assert page.stat().st_size > 10_000
        # Made again where it belongs, it is one of the folder's own, and may be replaced.
        for _ in range(2):
            assert run("report", tmp_path / "out/report.json", "--overwrite").returncode == 0
        assert ours(tmp_path / "out")
    with pytest.raises(Incomplete) as caught:
        monkeypatch.setattr(f"orthoscale.report.files.{where}", fail)
        fix(MODEL, tmp_path / "again", detections=BOXES, fleet="US", mode="planar")
    assert caught.value.result.scale.value > 0


def test_an_orthophoto_is_delivered_though_its_geopackage_fails(ortho, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("sqlite3_exec failed: database or disk is full")

    monkeypatch.setattr("pyogrio.raw.write", fail)
    done = fixed(ortho, ortho.parent / "out.tif", "--also", "gpkg")
    assert done.returncode == 6 and "out.tif.gpkg could not be written" in done.stderr and "scale  " in done.stdout
    assert names(ortho.parent) == sorted(
        ["a.tif", "a.tfw"] + [f"out.tif{end}" for end in ("", ".json", ".png", ".html")]
    )


@pytest.mark.slow
def test_a_full_disk_while_detections_are_saved_is_exit_code_6(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("sqlite3_exec failed: database or disk is full")

    monkeypatch.setattr("pyogrio.raw.write", fail)
    done = run("estimate", MODEL, *RULES, "--save-detections", tmp_path / "boxes.gpkg")
    assert done.returncode == 6 and "disk is full" in done.stderr and names(tmp_path) == []


@pytest.mark.slow
def test_a_symbolic_link_beside_a_model_is_not_followed(tmp_path):
    shutil.copytree(MODEL, tmp_path / "model")
    (tmp_path / "secret").write_text("precious")
    (tmp_path / "model/project.ini").write_text("plain")
    (tmp_path / "model/notes.txt").symlink_to(tmp_path / "secret")
    result = fix(tmp_path / "model", tmp_path / "out", detections=BOXES, fleet="US", mode="planar")
    assert "project.ini" in names(tmp_path / "out") and "notes.txt" not in names(tmp_path / "out")
    assert any("symbolic links: notes.txt" in note for note in map(str, result.source.notes))


# Messages


def test_messages_are_short_and_plain_whatever_a_name_is(tmp_path):
    name = tmp_path / os.fsdecode(b"a\x1b]0;owned\x07\nb\xff.tif")
    for words in (["estimate", name], ["estimate", "x" * 300], ["apply", "y" * 300, "z", "--out", tmp_path / "out"]):
        done = run(*words)
        assert done.returncode == 5, done.stderr
        assert done.stderr.count("\n") <= 2 and all(c.isprintable() or c == "\n" for c in done.stderr)
    done = run("estimate", MODEL, "--detections", tmp_path / ("q" * 200), "--fleet", "z" * 5000)
    assert done.returncode in (2, 5) and len(done.stderr) < 2500
    assert names(tmp_path) == []


def test_unreadable_inputs_are_exit_code_5(tmp_path, monkeypatch):
    (tmp_path / "boxes.json").write_text("no boxes")
    monkeypatch.setattr(os, "access", lambda *_, **__: False)  # root may read everything
    done = run("estimate", MODEL, "--detections", tmp_path / "boxes.json")
    assert done.returncode == 5 and "Usage" not in done.stderr


@pytest.mark.parametrize("left", [".DS_Store", "Thumbs.db", "desktop.ini", "._a", "inner/.DS_Store"])
def test_what_systems_leave_in_an_output_that_was_looked_at_is_nobodys(tmp_path, left):
    """Once it was opened in macOS's Finder, an output could never be replaced again."""
    write_folder(tmp_path / "out", ("a", "b"))
    write_folder(tmp_path / "out/inner", ("a", "b"))
    (tmp_path / "out" / left).write_bytes(b"\0\0\0\1Bud1")
    write_folder(tmp_path / "out", overwrite=True)
    assert names(tmp_path / "out") == [FOLDER_MARK, "x"]
    (tmp_path / "out" / ".mine").touch()
    with pytest.raises(UsageError, match="out holds .mine, which orthoscale did not write"):
        write_folder(tmp_path / "out", overwrite=True)


def test_what_is_in_the_way_in_an_output_within_another_is_named_itself(tmp_path):
    """A file that the user put into one of a workspace's models: it was a file of that model, which is orthoscale's."""
    write_folder(tmp_path / "out", ("a", "b"))
    write_folder(tmp_path / "out/inner", ("a", "b"))
    (tmp_path / "out/inner/mine").touch()
    before = state(tmp_path)
    with pytest.raises(UsageError, match="out holds inner/mine, which orthoscale did not write"):
        write_folder(tmp_path / "out", overwrite=True)
    assert state(tmp_path) == before
    (tmp_path / "out/inner/mine").unlink()
    write_folder(tmp_path / "out", overwrite=True)
    assert names(tmp_path / "out") == [FOLDER_MARK, "x"]
