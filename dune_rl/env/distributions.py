"""Settings of probability distributions."""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from dune_rl.core.settings import Settings


class _Interval(Settings):
    """A distribution on [low, high]."""

    name: str
    low: float
    high: float

    @model_validator(mode="after")
    def _is_ordered(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low must be at most high (got {self.low:g} and {self.high:g})")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest possible values."""
        return float(self.low), float(self.high)


class Uniform(_Interval):
    """Uniform distribution on [low, high]."""

    name: Literal["uniform"] = "uniform"

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a sample."""
        return float(rng.uniform(self.low, self.high))


class LogUniform(_Interval):
    """Log-uniform distribution on [low, high], both positive."""

    name: Literal["log_uniform"] = "log_uniform"
    low: float = Field(gt=0.0)
    high: float = Field(gt=0.0)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a sample."""
        sampled = float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))
        # Rounding may leave the limits.
        return min(max(sampled, self.low), self.high)


class Normal(_Interval):
    """Normal distribution, clipped to [low, high]."""

    name: Literal["normal"] = "normal"
    mean: float
    deviation: float = Field(ge=0.0)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a sample."""
        return min(max(float(rng.normal(self.mean, self.deviation)), self.low), self.high)


class Choice(Settings):
    """One of some numbers, all equally likely."""

    name: Literal["choice"] = "choice"
    values: tuple[float, ...] = Field(min_length=1)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a sample."""
        return self.values[int(rng.integers(len(self.values)))]

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest possible values."""
        return min(self.values), max(self.values)


class Integers(_Interval):
    """Any whole number from `low` to `high`, both included."""

    name: Literal["integers"] = "integers"
    low: int
    high: int

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a sample."""
        return float(rng.integers(self.low, self.high, endpoint=True))


def _from_list(kind: str) -> BeforeValidator:
    def parse(value: Any) -> Any:
        if not isinstance(value, list | tuple):
            return value
        if len(value) == 2:
            return {"name": kind, "low": value[0], "high": value[1]}
        return {"name": "choice", "values": value}

    return BeforeValidator(parse)


def _check_whole(settings: Integers | Choice) -> Integers | Choice:
    if isinstance(settings, Choice) and any(value != round(value) for value in settings.values):
        raise ValueError(f"values must be whole numbers (got {list(settings.values)})")
    return settings


# Short forms: a list of two numbers is an interval, a longer list a choice.
Distribution = Annotated[
    Uniform | LogUniform | Normal | Choice, Field(discriminator="name"), _from_list("uniform")
]
WholeNumbers = Annotated[
    Integers | Choice, Field(discriminator="name"), _from_list("integers"), AfterValidator(_check_whole)
]
