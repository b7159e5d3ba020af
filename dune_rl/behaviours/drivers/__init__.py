"""Reference drivers: classical navigation, to compare learned policies with."""
