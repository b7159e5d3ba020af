"""The base of every `*Conf` class."""

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """Frozen, typed settings; unknown keys, NaN and values out of range are refused on construction.

    A subclass stands beside the class it configures, states units in its field names (`range_m`, `rate_hz`)
    and ranges with `pydantic.Field(gt=0)` and the like. Nested settings are validated in one pass, so several
    faults are reported together.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True)
