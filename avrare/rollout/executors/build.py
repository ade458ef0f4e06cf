"""Choice of an executor by its name and number of workers."""

from __future__ import annotations

from typing import Any

from avrare.base.errors import UsageError
from avrare.plugin.registry import default_registry
from avrare.rollout.executors.work import Executor
from avrare.scenario.marked_values import Mark, Node
from avrare.scenario.overrides import override
from avrare.scenario.validation import check_options


def build_executor(workers: int, text: str | None = None) -> Executor:
    """Build an executor from its name and options.

    Args:
        workers: Number of processes.
        text: ``NAME`` or ``NAME,OPTION=VALUE,...``; None: serial, or processes for several workers.

    Raises:
        UsageError: An option is unknown or invalid.
        PluginError: No installed plugin provides the executor.
    """
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise UsageError(f"workers must be an integer of at least 1, not {workers!r}")
    name, *settings = (text or ("processes" if workers > 1 else "serial")).split(",")
    component = default_registry().require("executor", name)
    mark = Mark("--executor")
    options: dict[str, Any] = override(Node({}, mark, mark), settings).plain()
    config = check_options(component.load_config(), name, {"workers": workers, **options}, "executor")
    return component.load_factory()(config, None)  # type: ignore[no-any-return]
