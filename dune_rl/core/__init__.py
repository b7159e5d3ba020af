"""What every layer uses: errors, files, paths, random streams, settings and the registry of parts."""
