"""Settings of probability distributions."""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from dune_rl.core.settings import Settings


class Uniform(Settings):
    """Uniform distribution on [low, high]."""

    name: Literal["uniform"] = "uniform"
    low: float
    high: float

    @model_validator(mode="after")
    def _rises(self) -> Self:
        return _risen(self, self.low, self.high)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a sample."""
        return float(rng.uniform(self.low, self.high))

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest possible values."""
        return self.low, self.high


class LogUniform(Settings):
    """Log-uniform distribution on [low, high], both positive."""

    name: Literal["log_uniform"] = "log_uniform"
    low: float = Field(gt=0.0)
    high: float = Field(gt=0.0)

    @model_validator(mode="after")
    def _rises(self) -> Self:
        return _risen(self, self.low, self.high)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a sample."""
        sampled = float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))
        # Rounding may leave the limits.
        return min(max(sampled, self.low), self.high)

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest possible values."""
        return self.low, self.high


class Normal(Settings):
    """Normal distribution, clipped to [low, high]."""

    name: Literal["normal"] = "normal"
    mean: float
    deviation: float = Field(ge=0.0)
    low: float
    high: float

    @model_validator(mode="after")
    def _rises(self) -> Self:
        return _risen(self, self.low, self.high)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a sample."""
        return min(max(float(rng.normal(self.mean, self.deviation)), self.low), self.high)

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest possible values."""
        return self.low, self.high


class Choice(Settings):
    """One of some numbers, each as likely."""

    name: Literal["choice"] = "choice"
    values: tuple[float, ...] = Field(min_length=1)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a sample."""
        return self.values[int(rng.integers(len(self.values)))]

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest possible values."""
        return min(self.values), max(self.values)


class Integers(Settings):
    """Any whole number from `low` to `high`, both included."""

    name: Literal["integers"] = "integers"
    low: int
    high: int

    @model_validator(mode="after")
    def _rises(self) -> Self:
        return _risen(self, self.low, self.high)

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a sample."""
        return float(rng.integers(self.low, self.high, endpoint=True))

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest possible values."""
        return float(self.low), float(self.high)


def _risen(settings: Any, low: float, high: float) -> Any:
    if low > high:
        raise ValueError(f"low must be at most high (got {low:g} and {high:g})")
    return settings


def _from_list(kind: str) -> BeforeValidator:
    def longer(value: Any) -> Any:
        if not isinstance(value, list | tuple):
            return value
        if len(value) == 2:
            return {"name": kind, "low": value[0], "high": value[1]}
        return {"name": "choice", "values": value}

    return BeforeValidator(longer)


def _whole(settings: Integers | Choice) -> Integers | Choice:
    if isinstance(settings, Choice) and any(value != round(value) for value in settings.values):
        raise ValueError(f"values must be whole numbers (got {list(settings.values)})")
    return settings


# A list is short for one of them: of two numbers for all between these, of more for a choice.
Distribution = Annotated[
    Uniform | LogUniform | Normal | Choice, Field(discriminator="name"), _from_list("uniform")
]
WholeNumbers = Annotated[
    Integers | Choice, Field(discriminator="name"), _from_list("integers"), AfterValidator(_whole)
]
