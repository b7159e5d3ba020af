"""Learning of motion forecasts: what a tracker of agents cannot tell by the filter of each track alone."""
