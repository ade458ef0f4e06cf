"""Children of lark's trees, by their kind in the grammar."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lark import Token, Tree


def get_token(tree: Tree[Token], index: int) -> Token:
    """Return a child that is a token."""
    child = tree.children[index]
    assert isinstance(child, str)
    return child


def get_subtree(tree: Tree[Token], index: int) -> Tree[Token]:
    """Return a child that is a tree."""
    child = tree.children[index]
    assert not isinstance(child, str)
    return child
