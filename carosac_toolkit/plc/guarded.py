"""The driver `ads`: the guard on a robot behind a TwinCAT PLC."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from carosac_toolkit.safety.guard import GuardedDriver, GuardSettings


@dataclass(frozen=True, kw_only=True)
class GuardedAdsSettings(GuardSettings):
    """Settings of the guard; `inner` holds those of `carosac_toolkit.drivers.ads.AdsDriver`."""

    driver: str = "carosac_toolkit.drivers.ads:AdsDriver"


class GuardedAds(GuardedDriver):
    """A guarded `AdsDriver`; nothing is written to the PLC unless `motion` says so."""

    Settings: ClassVar[type[GuardedAdsSettings]] = GuardedAdsSettings
    name: ClassVar[str] = "ads"
