"""What a Python session or a notebook works with: runs of scenarios, traces, plots, live lines, reports."""
