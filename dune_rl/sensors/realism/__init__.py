"""Rate, latency, noise and drop-out models of real sensors."""
