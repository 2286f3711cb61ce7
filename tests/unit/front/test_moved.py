"""Old module paths: the error names the new place, and the new place is there."""

from __future__ import annotations

import importlib
from importlib.util import find_spec

import pytest

from interarea.moved import moved


@pytest.mark.parametrize("new", sorted(set(moved().values())))
def test_every_new_place_is_there(new: str) -> None:
    assert find_spec(f"interarea.{new}") is not None


def test_a_module_that_moved_is_named_in_one_line() -> None:
    with pytest.raises(ModuleNotFoundError) as caught:
        importlib.import_module("interarea.cosim.build")
    assert str(caught.value).startswith(
        "interarea.cosim.build of version 0.1 is interarea.cosim.run.system since 0.2"
    )


def test_a_folder_with_the_name_of_an_old_module_tells_too() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"^load_case .* is interarea\.models\.case\.case since"):
        exec("from interarea.models.case import load_case")
    with pytest.raises(ModuleNotFoundError, match=r"is interarea\.cosim\.run\.run since 0\.2"):
        exec("from interarea.cosim.run import run_scenario")


def test_what_never_was_is_not_found_as_ever() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"^No module named 'interarea\.nothing'$"):
        importlib.import_module("interarea.nothing")
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        exec("from interarea.design.linear import nothing")
