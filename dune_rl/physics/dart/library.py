"""Import of dartpy, with an error message that says how to install it."""

from dune_rl.core.errors import PhysicsError

try:
    import dartpy
except ImportError as error:
    raise PhysicsError(
        "physics=dart needs dartpy, which has wheels for Linux alone: pip install 'dartpy>=6.20,<7'; "
        "physics=bullet runs everywhere"
    ) from error

__all__ = ["dartpy"]
