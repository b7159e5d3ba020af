"""The inspection world: an industrial site with solar arrays, a bridge, a pipeline, walls and water."""
