"""The inspection site: solar arrays, a bridge, a pipeline, walls and water."""
