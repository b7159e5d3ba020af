"""Blocks of Markdown files that are made from files of results."""
