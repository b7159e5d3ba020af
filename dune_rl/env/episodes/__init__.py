"""Episodes: how they start, what was asked for or laid down beforehand, and what is told of them."""
