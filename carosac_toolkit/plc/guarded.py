"""The driver `ads`: the guard on a robot behind a TwinCAT PLC."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from carosac_toolkit.drivers.guard_settings import GuardSettings
from carosac_toolkit.drivers.guarded import GuardedDriver


@dataclass(frozen=True, kw_only=True)
class GuardedAdsSettings(GuardSettings):
    """Settings of the guard; `inner` are those of `carosac_toolkit.plc.driver.AdsDriver`."""

    driver: str = "carosac_toolkit.plc.driver:AdsDriver"


class GuardedAds(GuardedDriver):
    """A guarded `AdsDriver`; nothing is written to the PLC unless `motion` says so."""

    Settings: ClassVar[type[GuardedAdsSettings]] = GuardedAdsSettings
    name: ClassVar[str] = "ads"
