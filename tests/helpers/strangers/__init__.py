"""Files from strangers: samples of every format, ways to damage them, and a watch over their readers."""
