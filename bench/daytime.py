"""Compute surface minus air temperature by day, dusk, night and dawn from an energy balance, kelvin.

`bench/daytime.py [--latitude 45] [--day 2024-09-22]` heats slabs of several materials for four days, by the sun and sky
of `infrablend.thermal.sky` at 1 m/s of wind, and prints the means of the last day: by day above 20 degrees of sun,
by night below -6, dusk and dawn between -6 and 8 degrees. `share` is the place between night (0) and day (1). Then the
elevations of the sun at which pairs of materials swap places in the morning (thermal crossover).
"""

from __future__ import annotations

import argparse
import itertools
import math
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from infrablend.thermal.daytime import LOW_SUN_DEG
from infrablend.thermal.radiometry import STEFAN_BOLTZMANN_W_M2_K4
from infrablend.thermal.sky import clear_sky_emissivity, irradiance, sun_position

AIR_K, AIR_SWING_K, DEW_BELOW_K, EMISSIVITY = 288.0, 5.0, 7.0, 0.95
# Heat that the air takes, W/(m2 K): 5.7 + 3.8 v at 1 m/s.
TO_AIR = 9.5
DAYS, STEP_S = 4, 60.0


class Slab(NamedTuple):
    """A material: thickness m, conductivity W/(m K), heat capacity J/(m3 K), absorptivity for sunlight."""

    thickness_m: float
    conductivity: float
    capacity: float
    absorptivity: float


SLABS = {
    "asphalt": Slab(1.0, 1.2, 2.1e6, 0.9),
    "dry soil": Slab(1.0, 0.6, 1.6e6, 0.75),
    "concrete": Slab(1.0, 1.7, 2.0e6, 0.65),
    "tyre wall": Slab(0.012, 0.25, 1.9e6, 0.9),
    "car roof": Slab(0.0008, 50.0, 3.6e6, 0.7),
}


def simulate(slab: Slab, cloud: float, latitude_deg: float, day: datetime) -> NDArray[np.float64]:
    """Return (n, 3): elevation of the sun in degrees, whether it rises, and surface minus air temperature."""
    thick = slab.thickness_m > 0.1
    cells = np.geomspace(0.004, 0.06, 40) if thick else np.full(4, slab.thickness_m / 4)
    if slab.thickness_m < 0.005:  # one temperature throughout
        cells = np.array([slab.thickness_m])
    between = 2 * slab.conductivity / (cells[:-1] + cells[1:])
    stable_s = 0.4 * slab.capacity * float(cells.min()) ** 2 / slab.conductivity if len(cells) > 1 else 10.0
    steps = int(STEP_S / stable_s) + 1
    kelvin, found = np.full(len(cells), AIR_K), []
    for k in range(int(DAYS * 86_400 / STEP_S)):
        when, hour = day + timedelta(seconds=k * STEP_S), k * STEP_S / 3600 % 24
        azimuth, elevation = sun_position(when, latitude_deg, 0.0)
        air = AIR_K + AIR_SWING_K * (1 - 0.7 * cloud) * math.cos(2 * math.pi * (hour - 15) / 24)
        direct, diffuse = irradiance(elevation, cloud)
        sun = slab.absorptivity * (direct * max(math.sin(elevation), 0.0) + diffuse)
        sky = (1 - cloud) * clear_sky_emissivity(air - DEW_BELOW_K) + 0.97 * cloud
        for _ in range(steps):
            flow = between * -np.diff(kelvin)
            gain = np.zeros(len(cells))
            gain[0] = sun + TO_AIR * (air - kelvin[0])
            gain[0] += EMISSIVITY * STEFAN_BOLTZMANN_W_M2_K4 * (sky * air**4 - kelvin[0] ** 4)
            gain[:-1] -= flow
            gain[1:] += flow
            kelvin = kelvin + STEP_S / steps * gain / (slab.capacity * cells)
        if k * STEP_S >= (DAYS - 1) * 86_400:
            found.append((math.degrees(elevation), math.sin(azimuth) > 0, kelvin[0] - air))
    return np.array(found)


def main() -> None:
    """Print the table and the crossovers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--latitude", type=float, default=45.0)
    parser.add_argument("--day", default="2024-09-22")
    options = parser.parse_args()
    day, (low, high) = datetime.fromisoformat(options.day).replace(tzinfo=UTC), LOW_SUN_DEG
    clear = {}
    for cloud, name in itertools.product((0.0, 1.0), SLABS):
        found = simulate(SLABS[name], cloud, options.latitude, day)
        clear.setdefault(name, found)
        up, rises, warmer = found[:, 0], found[:, 1] > 0, found[:, 2]
        is_low = (up >= low) & (up <= high)
        means = [float(warmer[m].mean()) for m in (up > 20, is_low & ~rises, up < low, is_low & rises)]
        by_day, dusk, night, dawn = means
        shares = [(v - night) / (by_day - night) for v in (dusk, dawn)]
        text = "  ".join(f"{t} {v:5.1f}" for t, v in zip(("day", "dusk", "night", "dawn"), means, strict=True))
        sky = "overcast" if cloud else "clear"
        print(f"{name:10} {sky:9} {text}   share dusk {shares[0]:5.2f} dawn {shares[1]:5.2f}")
    for a, b in itertools.combinations(SLABS, 2):
        apart = clear[a][:, 2] - clear[b][:, 2]
        swaps = np.nonzero(np.diff(np.sign(apart)))[0]
        morning = [f"{clear[a][k, 0]:.0f}" for k in swaps if clear[a][k, 1]]
        print(f"{a} and {b}: {', '.join(morning) or 'no swap in the morning'}")


if __name__ == "__main__":
    main()
