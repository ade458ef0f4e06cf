"""Atomic writes: what they remove, and what they leave alone."""

import os
from pathlib import Path

import pytest

from avrare.base.atomic_files import remove_torn, write_atomic, write_text
from avrare.base.plot import Plot
from avrare.output.plots import make_figure


@pytest.fixture
def torn(tmp_path, monkeypatch):
    """Return a temporary file whose writer was killed."""

    def die(*_):
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", die)
        patch.setattr(os, "unlink", lambda _: None)
        with pytest.raises(MemoryError):
            write_text(tmp_path / "result.json", "half")
    (found,) = tmp_path.iterdir()
    return found


def test_only_own_temporary_files_are_removed(tmp_path, torn):
    others = [tmp_path / name for name in (".editor.tmp", ".result.json.abcdefgh.tmp", "x.avrare_1.tmp")]
    for other in others:
        other.write_text("of another program")
    remove_torn(tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(others)


def test_a_link_at_the_place_of_a_file_is_replaced_and_not_followed(tmp_path):
    mine, link = tmp_path / "mine", tmp_path / "result"
    mine.write_text("precious")
    plot = Plot(make_figure(1.0, 1.0))
    for write in (lambda: write_atomic(link, b"new"), lambda: plot.save(link)):
        link.unlink(missing_ok=True)
        link.symlink_to(mine)
        write()
        assert not link.is_symlink()
        assert mine.read_text() == "precious"


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="a matter of Unix")
def test_a_device_is_written_to_and_not_replaced():
    ours, theirs = os.openpty()
    try:
        path = Path(os.ttyname(theirs))
        write_text(path, "told")
        assert os.read(ours, 100) == b"told"
        assert path.is_char_device()
    finally:
        os.close(ours)
        os.close(theirs)
