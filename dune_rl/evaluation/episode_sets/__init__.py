"""Episode sets: numbered episodes with fixed worlds, starts and goals, the same for every policy."""
