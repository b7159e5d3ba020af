"""Networks of policies: encoders of vectors, scans and images, and the actor behind them."""
