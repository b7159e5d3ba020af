"""Films, contact sheets and maps of episodes."""
