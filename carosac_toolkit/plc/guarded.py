"""The driver `ads`: the guard around the driver of a robot behind a PLC."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from carosac_toolkit.safety.guard import GuardedDriver, GuardSettings


@dataclass(frozen=True, kw_only=True)
class GuardedAdsSettings(GuardSettings):
    """Settings of the guard; `inner` holds those of `carosac_toolkit.plc.driver.PlcDriver`."""

    driver: str = "carosac_toolkit.plc.driver:PlcDriver"


class GuardedAds(GuardedDriver):
    """A guarded `PlcDriver`; nothing is written to the PLC unless `motion` allows it."""

    Settings: ClassVar[type[GuardedAdsSettings]] = GuardedAdsSettings
    name: ClassVar[str] = "ads"
