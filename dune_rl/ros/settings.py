"""Settings of live topics: with whom they are shared, and how a scene runs on them."""

import os
import re
from typing import Any, Final, Literal
from xml.sax.saxutils import quoteattr

from pydantic import Field, field_validator

from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings

LOCALHOST, ANY = "localhost", "any"
# Participants of a domain on one machine that find each other without multicast.
MOST_PARTICIPANTS: Final = 32
# Age of a message [s] at which a robot stops.
MOST_AGE_S: Final = 0.5
_LAST_DOMAIN = 232
_DOMAIN_VARIABLE = "ROS_DOMAIN_ID"
_HOST = re.compile(r"[A-Za-z0-9_.:%-]+")


class NetworkConf(Settings):
    """With whom topics are shared.

    `domain` is that of DDS; None: ROS_DOMAIN_ID, or 0. `network` is `localhost`, `any` (the machine's own
    network) or the name or address of an interface. `peers` are machines to be found without multicast.
    """

    domain: int | None = Field(None, ge=0, le=_LAST_DOMAIN)
    network: str = LOCALHOST
    peers: tuple[str, ...] = ()

    @field_validator("network", "peers")
    @classmethod
    def _are_hosts(cls, value: Any) -> Any:
        for name in (value,) if isinstance(value, str) else value:
            if not _HOST.fullmatch(name):
                raise ValueError(f"names and addresses have letters, digits, dots and colons (got {name!r})")
        return value

    @property
    def domain_id(self) -> int:
        """The number of the domain; raises ConfigError where ROS_DOMAIN_ID is none."""
        if self.domain is not None:
            return self.domain
        text = os.environ.get(_DOMAIN_VARIABLE, "").strip() or "0"
        if not text.isdecimal() or int(text) > _LAST_DOMAIN:
            raise ConfigError(f"{_DOMAIN_VARIABLE}={text} must be a whole number from 0 to {_LAST_DOMAIN}")
        return int(text)

    @property
    def where(self) -> str:
        """The domain and the network in words."""
        return f"domain {self.domain_id} on {'this network' if self.network == ANY else self.network}"

    def xml(self) -> str:
        """The configuration of Cyclone DDS."""
        interface, multicast, peers = "", "default", list(self.peers)
        if self.network == LOCALHOST:
            interface, multicast = '<NetworkInterface address="127.0.0.1"/>', "false"
            peers.insert(0, LOCALHOST)
        elif self.network != ANY:
            key = "name" if re.match(r"[A-Za-z]", self.network) and ":" not in self.network else "address"
            interface = f"<NetworkInterface {key}={quoteattr(self.network)}/>"
        general = f"<Interfaces>{interface}</Interfaces>" if interface else ""
        known = "".join(f"<Peer Address={quoteattr(peer)}/>" for peer in peers)
        return (
            f"<CycloneDDS><Domain><General>{general}<AllowMulticast>{multicast}</AllowMulticast></General>"
            "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
            f"<MaxAutoParticipantIndex>{MOST_PARTICIPANTS}</MaxAutoParticipantIndex>"
            f"{f'<Peers>{known}</Peers>' if known else ''}</Discovery>"
            # Errors are reported by exceptions.
            "<Tracing><Verbosity>none</Verbosity></Tracing></Domain></CycloneDDS>"
        )


class LiveConf(Settings):
    """How a scene runs on live topics; see `LiveScene`."""

    speed: float = Field(1.0, ge=0.0, le=1000.0)
    on_end: Literal["stay", "reset"] = "stay"
    command_timeout_s: float = Field(0.5, gt=0.0)
    stamped: bool = False
    duration_s: float | None = Field(None, gt=0.0)


class DrivingConf(Settings):
    """How a policy drives on live topics, and when it stops; see `LiveDriver`."""

    stamped: bool = False
    dry_run: bool = False
    once: bool = False
    sim_time: bool | None = None
    max_age_s: float = Field(MOST_AGE_S, gt=0.0)
    wait_s: float = Field(10.0, gt=0.0, le=3600.0)
    duration_s: float | None = Field(None, gt=0.0)
    max_speed_mps: float | None = Field(None, gt=0.0)
    max_yaw_rate_radps: float | None = Field(None, gt=0.0)
    max_acceleration_mps2: float | None = Field(None, gt=0.0)
