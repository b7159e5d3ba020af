"""Worlds kept on disk between processes, and the background process that builds them ahead."""
