"""Where agents start and where they are to go: sources of starts and goals, and the start of an episode."""
