"""Physical and system constants (IS-GPS-200, WGS-84). SI units."""

from typing import Final

SPEED_OF_LIGHT_MPS: Final = 299_792_458.0
"""Speed of light in vacuum, m/s."""

GM_GPS_M3PS2: Final = 3.986005e14
"""Earth's gravitational parameter of the GPS broadcast orbit, m³/s² (IS-GPS-200 20.3.3.4.3)."""

EARTH_RATE_RADPS: Final = 7.2921151467e-5
"""Earth rotation rate of WGS-84, rad/s (IS-GPS-200 table 20-IV)."""

STANDARD_GRAVITY_MPS2: Final = 9.80665
"""What one g means, m/s² (3rd CGPM)."""

GPS_PI: Final = 3.1415926535898
"""π as the broadcast message counts semicircles (IS-GPS-200 20.3.3.4.3.2)."""

RELATIVITY_F_SPRM: Final = -4.442807633e-10
"""F of the relativistic clock term, s/√m (IS-GPS-200 20.3.3.3.3.1)."""

SECONDS_PER_WEEK: Final = 604_800
"""Seconds of a GPS week."""

BDT_MINUS_GPST_S: Final = -14.0
"""BDT − GPST, s."""
