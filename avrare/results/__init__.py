"""Run folders: their writer, their reader, and recordings."""
