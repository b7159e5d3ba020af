"""Adapters to other people's libraries, each in a module that needs its library."""
