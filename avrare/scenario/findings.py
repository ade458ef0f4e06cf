"""What a component's own check finds in its options, placed in the scenario."""

from __future__ import annotations

from avrare.errors import ExitCode
from avrare.plugin.finding import Finding
from avrare.scenario.explain import Problem
from avrare.scenario.schema import Block
from avrare.scenario.source import Node, Path


def check_block(
    block: Block, node: Node, path: Path, dt: float | None
) -> tuple[list[Problem], list[Problem]]:
    """Errors and warnings of a component's own check; empty where it has none.

    Args:
        block: The component with its options.
        node: Where it is written.
        path: Keys that lead to it.
        dt: Step of the simulator [s], None where it is not known.
    """
    errors: list[Problem] = []
    warnings: list[Problem] = []
    try:
        for found in block.component.find_faults(block.config, dt):
            (errors if found.is_error else warnings).append(_placed(found, node, path))
    except (Exception, SystemExit) as error:  # its fault, not the scenario's
        text = f"the plugin's own check failed: {type(error).__name__}: {' '.join(str(error).split())}"
        return [Problem(node.name_mark, path, text, None, ExitCode.PLUGIN)], []
    return errors, warnings


def _placed(found: Finding, node: Node, path: Path) -> Problem:
    """The finding at its option, or at the block where the option keeps its default."""
    if found.option is None:
        return Problem(node.name_mark, path, found.message, found.hint)
    written = node.child(found.option)
    mark = node.name_mark if written is None else written.mark
    return Problem(mark, (*path, found.option), found.message, found.hint)
