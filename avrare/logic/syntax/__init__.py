"""Syntax of formulas: parser, syntax tree and printer."""
