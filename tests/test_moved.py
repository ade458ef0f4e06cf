"""Old paths of modules lead to the modules at their new paths, not to copies of them."""

import importlib
import importlib.util
import sys

import pytest

import avrare.stack.closed_loop as closed_loop
from avrare.base.moved_modules import MOVED, RENAMED


@pytest.mark.parametrize("old", MOVED)
def test_every_new_path_exists(old):
    assert importlib.util.find_spec(MOVED[old]) is not None


@pytest.mark.parametrize("old", ["avrare.build", "avrare.build.closed_loop", "avrare.errors", *RENAMED])
def test_an_old_path_gives_the_module_itself(old):
    sys.modules.pop(old, None)
    with pytest.warns(DeprecationWarning, match="is now avrare"):
        module = importlib.import_module(old)
    assert module is importlib.import_module(MOVED[old])
    assert module.__spec__.name == MOVED[old]
    assert all(hasattr(module, name) for name in RENAMED.get(old, {}))


def test_modules_below_an_old_package_are_not_imported_twice():
    sys.modules.pop("avrare.build.closed_loop", None)
    with pytest.warns(DeprecationWarning, match="is now avrare"):
        from avrare.build.closed_loop import ClosedLoop
    assert ClosedLoop is closed_loop.ClosedLoop
