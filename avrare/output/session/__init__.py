"""Tools of a Python session or a notebook: runs of scenarios, traces, plots, live lines, reports."""
