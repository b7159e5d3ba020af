"""A training run: its folder, lock and logs, and what it shows while it goes on."""
