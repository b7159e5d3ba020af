"""The version of this package, for modules that must not import the package as a whole."""

VERSION = "0.1.0"
